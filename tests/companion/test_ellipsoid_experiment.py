"""The runs behind [LMV] Figures 1 to 3: what they record, when a chain ends, what is planned."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.experiments.ellipsoid import EXPERIMENTS, chain, compute, settled

SMALL = {
    **{"solution": "decay", "degree": 1, "refinements": 2, "evaluation": "lifted"},
    **{"order": 3, "steps_per_unit": 16},
}


def test_norms_over_a_window_of_one_step_are_those_at_the_end():
    e = compute(**SMALL, window=(1, 1))
    assert e["max_l2"] == e["end_l2"] > 0
    assert e["sum_h1"] == pytest.approx(e["end_h1"] / 4, rel=1e-14)
    assert e["nodes"] == 66


def test_a_longer_window_counts_more():
    short, long = (compute(**SMALL, window=(first, 1)) for first in (0.5, 0.25))
    assert short["end_l2"] == long["end_l2"]
    assert short["max_l2"] < long["max_l2"]
    assert short["sum_h1"] < long["sum_h1"]


def test_bisected_meshes_have_the_numbers_of_nodes_of_refined_ones_and_other_errors():
    refined = compute(**SMALL, window=(1, 1))
    bisected = compute(**SMALL | {"refinements": 4, "mesh": "bisected"}, window=(1, 1))
    assert bisected["nodes"] == refined["nodes"]
    assert bisected["h"] > 1.2 * refined["h"]
    assert bisected["end_l2"] != pytest.approx(refined["end_l2"], rel=0.05)


def test_the_sixth_order_runs_without_a_warning():
    assert compute(**SMALL | {"order": 6}, window=(1, 1))["end_l2"] > 0


def test_an_unknown_mesh_is_refused():
    with pytest.raises(ValueError, match='mesh must be "octahedron" or "bisected", got \'cube\''):
        compute(**SMALL | {"mesh": "cube"}, window=(1, 1))


@pytest.mark.parametrize(("factor", "expected"), [(1, True), (1.019, True), (0.975, False)])
def test_settled_looks_at_every_norm(factor, expected):
    before = {"max_l2": 1.0, "sum_h1": 2.0, "end_l2": 3.0, "end_h1": 4.0}
    for name in before:
        assert settled(before, before | {name: factor * before[name]}) is expected


def test_steps_of_a_chain_are_halved_and_no_case_is_planned_twice():
    cases = [case for experiment in EXPERIMENTS for c in experiment.chains for case in c]
    assert len({repr(sorted(case.items())) for case in cases}) == len(cases)
    for experiment in EXPERIMENTS:
        for c in experiment.chains:
            steps = np.array([case["steps_per_unit"] for case in c])
            assert (steps[1:] == 2 * steps[:-1]).all()
    assert [case["steps_per_unit"] for case in chain({"order": 1}, (4, 8))] == [4, 8]


def test_the_papers_mesh_is_planned():
    spaces = {(c[0]["degree"], c[0]["refinements"]) for c in EXPERIMENTS[0].chains}
    assert len(ec.sphere("octahedron", 7).vertices) == 65538
    assert (1, 7) in spaces
