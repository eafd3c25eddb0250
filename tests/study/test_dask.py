"""A study on a real cluster, on loopback, one of whose workers is killed."""

import os
import signal
import sys

import pytest

import esfem_core as ec

distributed = pytest.importorskip("distributed")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # of the cluster's own, about what is killed
    pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX"),
]


def growth(alpha, steps):
    """Area at t = 1/2 of a sphere that grows by what it carries."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
    problem = ec.Problem(lambda x: 1 + x[:, 2], g=lambda at: at.u, alpha=alpha, beta=0.1)
    last = ec.study.final(ec.evolve(space, problem, 2, 0.5 / steps, 0.5))
    return {"pid": os.getpid(), "area": ec.measure(last).area, "u": last.u}


def test_a_worker_killed_in_mid_study_changes_nothing(tmp_path):
    cases = ec.study.grid(alpha=(0.1, 0.2, 0.4, 0.8), steps=(10, 20, 40))
    alone = ec.study.run(cases, growth, tmp_path / "alone", workers=0, progress=False)
    killed = []

    def kill(line):
        if line.startswith("3/"):
            killed.extend(client.run(os.getpid).values())
            os.kill(killed[0], signal.SIGKILL)

    options = {"threads_per_worker": 1, "dashboard_address": None, "local_directory": tmp_path}
    with (
        distributed.LocalCluster(n_workers=2, host="127.0.0.1", **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        study = ec.study.run(cases, growth, tmp_path, client.get_executor(), progress=kill)
    assert study.failures == []
    assert [row.parameters for row in study.rows] == cases
    for one, other in zip(study.rows, alone.rows, strict=True):
        assert one.results["pid"] != other.results["pid"]
        assert one.results | {"pid": 0} == other.results | {"pid": 0}
    assert {row.results["pid"] for row in study.rows} & {*killed}
    assert len(ec.study.read(tmp_path / "growth.jsonl")) == len(cases)
