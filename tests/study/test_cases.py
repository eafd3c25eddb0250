"""Studies of many cases, computed in this process: what is kept, found, renewed and refused."""

import errno
import functools
import gzip
import hashlib
import json
import os
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor, wait
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import (
    Experiment,
    Results,
    StudyWarning,
    grid,
    outcomes,
    read,
    rows,
    run,
    select,
)

FACTOR = 1


def power(order, step):
    if step == 0.125 and order == 2:
        raise ArithmeticError("no convergence")
    return {"error": FACTOR * step**order + 0.1}


def study(folder, cases, compute=power, **options):
    lines = []
    options = {"workers": 0, "progress": lines.append} | options
    return run(cases, compute, folder, **options), lines


def test_rows_stand_in_the_order_of_the_cases(tmp_path):
    cases = grid(order=(1, 3), step=(0.5, 0.25))
    results, lines = study(tmp_path, cases)
    assert [row.parameters for row in results.rows] == cases
    assert results.rows[3].results == {"error": 0.25**3 + 0.1}
    assert results.failures == []
    assert lines[0] == "1/4 power: order=1, step=0.5: 0.0 s"
    assert str(results).splitlines()[0].split() == ["order", "step", "error"]
    assert read(tmp_path / "power.jsonl") == results.rows
    assert [path.name for path in tmp_path.iterdir()] == ["power.jsonl"]


def test_a_larger_study_computes_what_is_new_only(tmp_path):
    study(tmp_path, grid(order=(1,), step=(0.5, 0.25)))
    # The order of names and the type of a whole number are no other case.
    cases = [{"step": 0.25, "order": 1.0}, {"step": 0.75, "order": 1}]
    results, lines = study(tmp_path, cases)
    assert [line.rpartition(": ")[2] for line in lines] == ["found", "0.0 s"]
    assert [row.results["error"] for row in results.rows] == [0.35, 0.85]
    assert len(read(tmp_path / "power.jsonl")) == 3


def test_a_checksum_makes_a_case_of_a_changed_file_anew(tmp_path):
    file = tmp_path / "numbers.txt"

    def compute(name, **_):
        return {"sum": sum(map(int, Path(name).read_text().split()))}

    def sums(**more):
        return [row.results["sum"] for row in study(tmp_path, [more], compute)[0].rows]

    def checksum():
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]

    file.write_text("1 2")
    assert sums(name=str(file)) == sums(name=str(file), checksum=checksum()) == [3]
    file.write_text("3 4")
    assert sums(name=str(file)) == [3]  # contents do not count
    assert sums(name=str(file), checksum=checksum()) == [7]


def test_a_failing_case_ends_its_chain_and_no_other(tmp_path):
    chains = [[{"order": p, "step": 0.5**k} for k in range(5)] for p in (1, 2)]
    with pytest.warns(StudyWarning, match=r"^1 of the cases failed, the first one with order=2, s"):
        results, lines = study(tmp_path, chains)
    assert len(results.rows) == 8
    [(parameters, error)] = results.failures
    assert (parameters, str(error)) == ({"order": 2, "step": 0.125}, "no convergence")
    assert "test_cases.py" in error.__notes__[0]
    assert "10/10 power: order=" in lines[-1]
    assert str(results).endswith("failed: order=2, step=0.125: ArithmeticError: no convergence")


def test_a_chain_ends_when_it_is_enough(tmp_path):
    def settled(before, after):
        return after["error"] > 0.5 * before["error"]

    chain = [{"order": 1, "step": 0.5**k} for k in range(5)]
    for _ in range(2):  # computed, and found
        results, _ = study(tmp_path, [chain], enough=settled)
        assert [row.parameters["step"] for row in results.rows] == [1, 0.5]


def nothing(*results):
    return 1 / 0


FAILING = {
    nothing: "raised ZeroDivisionError: division by zero",
    lambda before, after: np.array([True, False]): "must be True or False, got an array of shape",
    lambda before, after: None: "must be True or False, got None",
    lambda one: True: "raised TypeError: .*takes 1 positional argument but 2 were given",
}


@pytest.mark.parametrize("enough", FAILING)
def test_an_error_in_enough_ends_its_chain_and_no_other(tmp_path, enough):
    chains = [[{"order": 1, "step": 0.5**k} for k in range(4)], [{"order": 3, "step": 1}]]
    for last in ("0.0 s", "found"):
        with pytest.warns(StudyWarning, match="the first one with order=1"):
            results, lines = study(tmp_path, chains, enough=enough)
        kept = [(row.parameters["order"], row.parameters["step"]) for row in results.rows]
        assert kept == [(1, 1), (1, 0.5), (3, 1)]
        [(parameters, error)] = results.failures
        assert parameters == {"order": 1, "step": 0.25}
        text = r"not begun: enough\(previous, current\), of the two cases before, "
        assert re.match(text + FAILING[enough], str(error))
        assert {"5/5"} <= {line[:3] for line in lines}
        assert lines[0].endswith(last)


def test_enough_is_not_asked_where_nothing_is_left_of_the_chain(tmp_path):
    results, _ = study(tmp_path, [grid(order=[1], step=[1, 0.5])], enough=nothing)
    assert (len(results.rows), results.failures) == (2, [])


def test_what_looks_at_results_cannot_change_what_is_kept(tmp_path, monkeypatch):
    def enough(before, after):
        before["error"] = after["error"] = -1.0
        return False

    chain = grid(order=[1], step=[1.0, 0.5, 0.25])
    kept = [1.1, 0.6, 0.35]
    for _ in range(2):  # computed, and found
        results, _ = study(tmp_path, [chain], enough=enough)
        assert [row.results["error"] for row in results.rows] == kept
    experiment = Experiment("power", "", power, [chain])
    monkeypatch.setitem(globals(), "FACTOR", 2)
    study(tmp_path, chain[:2])  # so that the last row is replaced, and the others written again
    for outcome in outcomes([experiment], tmp_path, workers=0, stale="renew"):
        outcome.row.results["error"] = -1.0
    rows = read(tmp_path / "power.jsonl")
    assert [row.results["error"] for row in rows] == [2.1, 1.1, 0.6]


def test_rows_of_other_code_are_renewed_in_their_place_or_kept(tmp_path, monkeypatch):
    cases = grid(order=(1,), step=(1.0, 0.5, 0.25))
    before, _ = study(tmp_path, cases)
    monkeypatch.setitem(globals(), "FACTOR", 2)
    assert study(tmp_path, cases, stale="keep")[0] == before
    after, lines = study(tmp_path, cases[1:2])
    assert [row.results["error"] for row in after.rows] == [1.1]
    assert "found" not in lines[0]
    rows = read(tmp_path / "power.jsonl")
    assert [row.parameters for row in rows] == cases
    assert [row.results["error"] for row in rows] == [1.1, 1.1, 0.35]


@pytest.mark.skipif(os.name != "posix", reason="Windows has other permissions")
@pytest.mark.parametrize("mode", [0o640, 0o600, 0o666])
def test_a_file_of_which_a_row_is_renewed_keeps_its_permissions(tmp_path, monkeypatch, mode):
    cases, path = grid(order=(1,), step=(1.0, 0.5)), tmp_path / "power.jsonl"
    study(tmp_path, cases)
    path.chmod(mode)
    monkeypatch.setitem(globals(), "FACTOR", 2)
    study(tmp_path, cases)
    assert path.stat().st_mode & 0o777 == mode


def test_a_row_that_cannot_be_renewed_stays(tmp_path):
    def compute(size):
        if broken:
            raise ArithmeticError
        return {"size": size}

    broken = False
    before, _ = study(tmp_path, grid(size=[1]), compute)
    broken = True
    with pytest.warns(StudyWarning):
        assert study(tmp_path, grid(size=[1]), compute)[0].rows == []
    assert read(tmp_path / "compute.jsonl") == before.rows


class Pair(dict):
    pass


VALUES = {
    "integer": (np.int64(3), 3),
    "single precision": (np.float32(0.5), 0.5),
    "long": (np.longdouble(0.5), 0.5),
    "truth": (np.bool_(True), True),
    "text": (np.str_("a"), "a"),
    "array": (np.arange(4).reshape(2, 2), [[0, 1], [2, 3]]),
    "long array": (np.array([0.5], np.longdouble), [0.5]),
    "tuple": ((1, None), [1, None]),
    "measures": (ec.errors.Errors(*range(6)), dict(ec.errors.Errors(*range(6))._asdict())),
    "mapping": (Pair(x=1), {"x": 1}),
}


def test_numpy_values_are_kept_as_numbers_and_lists(tmp_path):
    def compute(name):
        return {"value": VALUES[name][0]}

    results, _ = study(tmp_path, grid(name=list(VALUES)), compute)
    assert [row.results["value"] for row in results.rows] == [v for _, v in VALUES.values()]
    assert read(tmp_path / "compute.jsonl") == results.rows


def test_a_member_of_an_enum_of_texts_is_its_text(tmp_path):
    class Colour(str, Enum):  # noqa: UP042
        RED = "red"

    def compute(colour, red):
        return {"is": colour, "by": {Colour.RED: red}}

    results, _ = study(tmp_path, [{"colour": Colour.RED, Colour.RED: 3}], compute)
    row = results.rows[0]
    assert row.parameters == {"colour": "red", "red": 3}
    assert row.results == {"is": "red", "by": {"red": 3}}
    assert [*map(type, row.parameters), *map(type, row.results["by"])] == 3 * [str]


def test_results_that_json_cannot_hold_are_refused_by_name_and_the_others_kept(tmp_path):
    others = {"complex": 1j, "key": {1: 2}, "set": {1}, "object": [object()], "c": np.array([1j])}
    loop = []
    loop.append(loop)

    def compute(name):
        return {"value": loop} if name == "loop" else {"value": others.get(name, 1)}

    others["holes"] = np.ma.array([1.0, 2.0], mask=[False, True])
    others["days"] = np.array(["2026-01-01"], dtype="datetime64[D]")
    with pytest.warns(StudyWarning, match="^8 of the cases failed"):
        results, _ = study(tmp_path, grid(name=[*others, "loop", "good"]), compute)
    assert [row.parameters["name"] for row in results.rows] == ["good"]
    told = {failure.parameters["name"]: str(failure.error) for failure in results.failures}
    assert told["complex"].startswith("results['value'] must be a number, a string, ")
    assert told["complex"].endswith("with strings as keys, got 1j")
    assert told["object"].startswith("results['value'][0] must be a number")
    assert told["key"].endswith("got {1: 2}")
    assert told["holes"].startswith("results['value'] must hold numbers, but is masked")
    assert told["days"].endswith("must hold numbers or strings, got an array of datetime64[D]")
    with pytest.warns(StudyWarning, match="results must be a dict, got 7"):
        study(tmp_path, grid(size=[1]), lambda size: 7, name="seven")


def test_a_study_ends_at_once_when_progress_raises(tmp_path):
    def refuse(line):
        raise ArithmeticError(line)

    with pytest.raises(ArithmeticError) as kept:  # as a notebook keeps it
        study(tmp_path, grid(order=(1,), step=(0.5, 0.25)), progress=refuse)
    assert "power: order=1, step=0.5" in str(kept.value)
    assert [path.name for path in tmp_path.iterdir()] == ["power.jsonl"]  # no lock is left
    assert len(read(tmp_path / "power.jsonl")) == 1


def test_a_function_that_changes_its_arguments_changes_no_case(tmp_path):
    def compute(axes, options):
        axes.append(7)
        options["tol"] = 0
        return {"n": len(axes)}

    cases = grid(axes=([1], [1, 2]), options=({"tol": 1},))
    results, _ = study(tmp_path, cases, compute)
    assert [row.parameters for row in results.rows] == cases
    assert [row.results["n"] for row in results.rows] == [2, 3]
    assert read(tmp_path / "compute.jsonl") == results.rows
    assert study(tmp_path, cases, compute)[1][0].endswith("found")


def test_a_result_does_not_hide_the_parameter_of_its_name(tmp_path):
    results, _ = study(tmp_path, grid(h=(0.5,)), lambda h: {"h": 0.25}, name="n")
    assert [line.split() for line in str(results).splitlines()] == [
        ["h", "h", "(result)"],
        ["0.5", "0.25"],
    ]
    ec.save_table(tmp_path / "n.csv", results.table())
    assert (tmp_path / "n.csv").read_text() == "h,h (result)\n0.5,0.25\n"


def test_a_table_of_a_study_has_all_parameters_and_results():
    first, second = {"h": 0.25, "h (result)": 3, "e": [1, 2]}, {"h (result)": 3, "h": 0.25, "e": 4}
    found = [rows.Row({"h": 0.5, "p": 1}, results, {}) for results in (first, second)]
    assert Results(found, []).table() == [
        {"h": 0.5, "p": 1, "h (result)": 0.25, "h (result) (result)": 3, "e": [1, 2]},
        {"h": 0.5, "p": 1, "h (result)": 3, "h (result) (result)": 0.25, "e": 4},
    ]
    assert found[0].results == {"h": 0.25, "h (result)": 3, "e": [1, 2]}


def test_an_integer_too_long_to_be_written_costs_its_own_case_only(tmp_path):
    with pytest.warns(
        StudyWarning, match=r"results\['n'\] must be an integer of at most 1024 bits"
    ):
        results, _ = study(
            tmp_path, grid(digits=(5000, 3)), lambda digits: {"n": 10**digits}, name="n"
        )
    assert [row.results["n"] for row in results.rows] == [1000]
    assert read(tmp_path / "n.jsonl") == results.rows


def test_rows_are_selected_by_values_of_any_library(tmp_path):
    results, _ = study(tmp_path, grid(axes=([1, 2], [1, 3])), lambda axes: {}, name="n")
    for axes in ((1, 2), [1.0, 2.0], np.array([1, 2])):
        assert select(results.rows, axes=axes) == results.rows[:1]


def test_rows_are_selected_by_what_tells_cases_apart(tmp_path):
    values = (1, True, None, float("nan"), -0.5)
    rows = study(tmp_path, grid(v=values), lambda v: {}, name="n")[0].rows
    assert len(rows) == len(values)
    for value, row in zip(values, rows, strict=True):
        assert select(rows, v=value) == [row]
    assert select(rows, v=1.0) == rows[:1]
    assert select(rows, other=None) == rows
    assert select(rows, other=1) == []


@pytest.mark.parametrize("values", ["updated", 3, np.array(2), {"tol": 1e-3, "order": 2}])
def test_a_single_value_is_no_sequence_of_values(values):
    with pytest.raises(
        TypeError, match=r"mass must be a sequence of values, got .*; a tuple holds"
    ):
        grid(mass=values)


def test_a_path_is_a_path():
    with pytest.raises(TypeError, match="path must be the path of a file, got None"):
        read(None)


GOOD = '{"parameters": {"size": 1}, "results": {"size": 1}, "provenance": {"esfem_core": "0"}}'
ROW = rows.Row({"size": 2}, {"size": 2}, {"esfem_core": "0"})


@pytest.mark.parametrize(
    "end", ['\n{"parameters": {"si', "\n", "", "\n\n", "\n\0\0", '\n{"parameters": "\xe4']
)
def test_a_last_line_without_end_loses_no_row(tmp_path, end):
    path = tmp_path / "compute.jsonl"
    path.write_bytes(f"{GOOD}{end}".encode()[: -1 if "\xe4" in end else None])
    results, lines = study(
        tmp_path, grid(size=(1, 2)), lambda size: {"size": size}, name="compute", stale="keep"
    )
    assert [row.results["size"] for row in results.rows] == [1, 2]
    assert lines[0].endswith("found")
    lines = filter(None, path.read_text("ascii").split("\n"))
    assert [json.loads(line)["parameters"]["size"] for line in lines] == [1, 2]


def test_a_row_is_cut_off_wherever_it_ends():
    values = {"x": [-0.5, 1e-300, 10**30], "no": [np.nan, -np.inf, np.inf, None, True, False]}
    line = rows._line(rows.Row({"size": 1}, values | {"text": 'ä\\"\n'}, {}))[:-1]
    assert all(rows._is_cut_off(line[:size]) for size in range(len(line)))
    assert all(rows._is_cut_off(line[:size] + b"\0\0") for size in range(len(line) + 1))
    assert not rows._is_cut_off(line)


def test_a_line_that_a_killed_process_has_left_hides_none_that_were_put_after_it(tmp_path):
    path = tmp_path / "a.jsonl"
    other = GOOD.replace('{"size": 1}', '{"size": 2}')
    path.write_text(f"{GOOD[:40]}\n\n{GOOD}\n{other[:-3]}\n{other}\n")
    assert [row.parameters["size"] for row in read(path)] == [1, 2]


# One line without an end, which is no beginning of a row: what another program has written.
FOREIGN = ["a, b, c", f"{GOOD}\nremarks", '{"a": 1}', GOOD.replace("results", "other"), "3"]
# Rows that have lost their ends of lines, or a comma, or were followed by something.
FOREIGN += [f"{GOOD}\r{GOOD}\r", GOOD + GOOD, f"{GOOD}\n{GOOD.replace(', ', ' ', 1)}", f"{GOOD}x"]


@pytest.mark.parametrize(
    "text", ["no json\n", f"{GOOD}\n{{}}\n", "[]\n", f"{GOOD}x\n", "\x00\n", *FOREIGN]
)
def test_a_file_that_holds_something_else_is_refused_and_left_alone(tmp_path, text):
    path = tmp_path / "power.jsonl"
    path.write_bytes(text.encode())
    with pytest.raises(ValueError, match=r"power\.jsonl is not a file of results: line \d: "):
        study(tmp_path, grid(order=[1], step=[1]))
    assert path.read_bytes() == text.encode()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (gzip.compress, "line 1: it is compressed: unpack it$"),
        (lambda data: data.decode().encode("utf-16"), "line 1: it is text in UTF-16: save it as"),
        (lambda data: data.replace(b"\n", b"\r") + data, "JSON: Extra data, character 88$"),
        (lambda data: data + b"\xe4 = 3", "line 2: it is no JSON, but begins with '\ufffd = 3'"),
    ],
)
def test_what_has_become_of_a_file_is_told(tmp_path, changed, message):
    path = tmp_path / "a.jsonl"
    path.write_bytes(changed(f"{GOOD}\n".encode()))
    with pytest.raises(ValueError, match=message):
        read(path)


def test_a_folder_in_the_place_of_the_file_is_told_before_a_case_is_computed(tmp_path):
    (tmp_path / "a.jsonl").mkdir()
    with pytest.raises(IsADirectoryError, match=r"the file '.*a\.jsonl', but this is a folder"):
        study(tmp_path, grid(size=[1]), lambda size: pytest.fail("began"), name="a")


def test_the_last_row_of_a_case_counts(tmp_path):
    path = tmp_path / "a.jsonl"
    other = GOOD.replace('{"size": 1}', '{"size": 2}')
    newer = GOOD.replace('"0"', '"1, source new"')
    path.write_text(f"{GOOD}\n{other}\n{newer}\n")
    assert [(row.parameters["size"], row.code) for row in read(path)] == [(1, "new"), (2, "")]


def test_rows_are_read_once_however_many_there_are(tmp_path, monkeypatch):
    sizes, parse = [], rows._parse

    def counted(path, data):
        sizes.append(len(data))
        return parse(path, data)

    monkeypatch.setattr(rows, "_parse", counted)
    results, _ = study(tmp_path, grid(size=range(20)), lambda size: {"size": size}, name="a")
    assert sum(sizes) == 0  # one knows what one has written
    assert read(tmp_path / "a.jsonl") == results.rows
    sizes.clear()
    study(tmp_path, grid(size=range(20)), lambda size: {"size": size + 1}, name="a")
    size = len(b"".join(map(rows._line, results.rows)))
    assert (
        size < sum(sizes) < 4 * size
    )  # once before, and all lines when it leaves out the old ones


def test_others_write_while_rows_are_renewed_and_nothing_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "TAIL", 100)
    path = tmp_path / "a.jsonl"
    store, other = rows.Store(path), rows.Store(path)
    codes = [{"esfem_core": f"0, source {code}"} for code in "abc"]
    for k in range(6):
        store.put(rows.Row({"size": k}, {}, codes[0]))
    for k in range(6):
        (store, other)[k % 2].put(rows.Row({"size": k}, {}, codes[1]))
    assert len(path.read_text().splitlines()) == 12
    assert [row.code for row in read(path)] == ["b"] * 6
    other.close()
    assert len(path.read_text().splitlines()) == 6
    store.put(rows.Row({"size": 0}, {}, codes[2]))
    path.write_text(
        path.read_text().replace('{"size": 3}, "results": {}', '{"size": 7}, "results": {}')
    )
    store.close()  # what it leaves is what is there, and not what it remembers
    kept = [(row.parameters["size"], row.code) for row in read(path)]
    assert kept == [(0, "c"), (1, "b"), (2, "b"), (7, "b"), (4, "b"), (5, "b")]
    assert len(path.read_text().splitlines()) == 6


def test_without_room_for_a_new_file_renewed_rows_stay_at_the_end_of_the_old_one(
    tmp_path, monkeypatch
):
    def refuse(path, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    study(tmp_path, grid(size=(1, 2)), lambda size: {"size": size}, name="a")
    monkeypatch.setattr(rows, "write_whole", refuse)
    results, _ = study(tmp_path, grid(size=(1, 2)), lambda size: {"size": -size}, name="a")
    assert [row.results["size"] for row in results.rows] == [-1, -2]
    assert read(tmp_path / "a.jsonl") == results.rows


def test_a_store_sees_what_others_do_to_its_file(tmp_path):
    path = tmp_path / "a.jsonl"
    store, other = rows.Store(path), rows.Store(path)
    one, two, three = (rows.Row({"size": size}, {}, {}) for size in (1, 2, 30))
    lines = [rows._line(row) for row in (one, two, three)]
    store.put(one)
    other.put(two)
    assert store.find({"size": 2}) == two
    path.write_bytes(b"".join(lines[1:]))  # in place, and longer than before
    assert (store.find({"size": 1}), store.find({"size": 30})) == (None, three)
    path.write_bytes(lines[0] + lines[2] + lines[1][:20])
    store.put(two)
    assert path.read_bytes() == lines[0] + lines[2] + lines[1]
    path.write_bytes(path.read_bytes() + b"spoilt\n")
    with pytest.raises(ValueError, match="line 4: it is no JSON, but begins with 'spoilt'"):
        store.find({"size": 1})
    path.unlink()
    assert store.find({"size": 1}) is None
    store.close()
    other.close()


def test_a_mark_of_a_merge_is_shown(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text(f"{GOOD}\n<<<<<<< HEAD\n{GOOD}\n=======\n")
    with pytest.raises(ValueError, match="line 2: it is no JSON, but begins with '<<<<<<< HEAD'"):
        read(path)


def test_a_file_that_is_spoilt_in_mid_study_costs_no_row(tmp_path):
    path = tmp_path / "compute.jsonl"

    def compute(size):
        if size == 2:
            path.write_text("spoilt\n")
        return {"size": size}

    with (
        pytest.warns(StudyWarning, match="is not a file of results: line 1"),
        pytest.raises(ValueError, match=r"compute\.jsonl is not a file of results: line 1"),
    ):
        study(tmp_path, grid(size=(1, 2, 3)), compute)
    assert path.read_text() == "spoilt\n"


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        (
            {"cases": {"order": 1}},
            TypeError,
            "cases must be a sequence of dicts of parameters, got {'",
        ),
        ({"cases": 3}, TypeError, "cases must be a sequence of dicts of parameters, got 3"),
        (
            {"cases": ["a"]},
            TypeError,
            "a chain of cases must be a sequence of dicts of parameters, g",
        ),
        ({"cases": [[1]]}, TypeError, "a case must be a dict of parameters, got 1"),
        (
            {"cases": [{"f": {"x": [np.zeros(3)]}}]},
            TypeError,
            r"a case\['f'\]\['x'\]\[0\] must be a number, a string, a boolean, None, or a list or",
        ),
        ({"cases": [{"f": len}]}, TypeError, r"a case\['f'\] must be a number, .* got <built-in"),
        ({"compute": 3}, TypeError, "compute must be a function, got 3"),
        ({"compute": lambda: 0}, ValueError, "name must be made of letters, .* got '<lambda>'"),
        (
            {"compute": functools.partial(power)},
            ValueError,
            "name must .* got ''; where compute has",
        ),
        ({"name": "../a"}, ValueError, "name must be made of letters, digits, .* got '../a'"),
        ({"workers": -1}, ValueError, "workers must be an integer >= 0, got -1"),
        ({"workers": None, "threads": 0}, ValueError, "threads must be an integer >= 1, got 0"),
        ({"threads": "1"}, TypeError, "threads must be an integer >= 1, got '1'"),
        ({"enough": 3}, TypeError, "enough must be a function of two results, or None, got 3"),
        (
            {"progress": None},
            TypeError,
            "progress must be True, False or a function of a line, got None",
        ),
        ({"folder": None}, TypeError, "folder must be the path of a folder, got None"),
        ({"folder": "a\0"}, ValueError, r"folder must be the path of a folder, got 'a\\x00'"),
        ({"folder": __file__}, OSError, "folder must be a folder, but .* is a file"),
        ({"executor": 2}, TypeError, "executor must be a concurrent.futures.Executor or None, go"),
        ({"stale": "no"}, ValueError, 'stale must be "renew" or "keep", got \'no\''),
    ],
)
def test_arguments_that_are_none_are_refused_before_anything_is_made(
    tmp_path, change, kind, message
):
    arguments = {"cases": [{"order": 1, "step": 1}], "compute": power, "folder": tmp_path / "new"}
    with pytest.raises(kind, match=f"^{message}"):
        run(**({"workers": 0, "progress": False} | arguments | change))
    assert not (tmp_path / "new").exists()


def test_a_folder_that_cannot_be_written_is_told_before_a_case_is_computed(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        study(tmp_path / "file", grid(size=[1]), lambda size: pytest.fail("began"), name="none")


def test_a_case_that_stands_twice_is_computed_once(tmp_path):
    called = []

    def compute(size):
        called.append(size)
        return {"size": size}

    with ThreadPoolExecutor(2) as pool:
        results, _ = study(tmp_path, [{"size": 1}] * 3, compute, executor=pool, workers=None)
    assert len(results.rows) == len(called) == len(read(tmp_path / "compute.jsonl")) == 1


def test_any_executor_computes_and_is_left_open(tmp_path):
    cases = grid(order=(1, 3), step=(0.5, 0.25))
    with ThreadPoolExecutor(2) as pool:
        results, _ = study(tmp_path, cases, executor=pool, workers=2)
        assert pool.submit(len, "ab").result() == 2
    assert [row.parameters for row in results.rows] == cases


def test_the_table_escapes_what_it_shows(tmp_path):
    results, _ = study(tmp_path, [{"name": "<b>"}], lambda name: {"<i>": name}, name="html")
    shown = results._repr_html_()
    assert "<b>" not in shown
    assert "&lt;i&gt;" in shown


def test_no_row_is_computed_by_a_process_that_has_loaded_other_code(tmp_path, monkeypatch):
    (tmp_path / "loaded_before.py").write_text("N = 3\ndef size(n):\n    return {'size': n * N}\n")
    monkeypatch.syspath_prepend(tmp_path)
    import loaded_before

    class Pool(ThreadPoolExecutor):
        def submit(self, fn, /, *args):
            with monkeypatch.context() as patch:
                patch.setattr(loaded_before, "N", 4)
                future = super().submit(fn, *args)
                wait([future])
            return future

    with Pool(1) as pool, pytest.warns(StudyWarning, match="RuntimeError: loaded_before.size, or"):
        results, _ = study(tmp_path, [{"n": 1}], loaded_before.size, executor=pool, workers=1)
    assert results.rows == []
    [failure] = results.failures
    assert "after one of them had read it; start both anew" in str(failure.error)


def test_a_folder_that_is_renamed_in_mid_study_costs_no_row(tmp_path):
    folder, other = tmp_path / "results", tmp_path / "renamed"

    def compute(size):
        if size == 2:
            folder.rename(other)
        return {"size": size}

    results, _ = study(folder, grid(size=(1, 2, 3)), compute)
    assert [row.results["size"] for row in results.rows] == [1, 2, 3]
    assert [len(read(path / "compute.jsonl")) for path in (other, folder)] == [1, 2]


@pytest.fixture
def read_only(tmp_path):
    """A file of one row into which nobody may write."""
    study(tmp_path, grid(size=[1]), lambda size: {"size": size}, name="a", stale="keep")
    path = tmp_path / "a.jsonl"
    path.chmod(0o444)
    if os.access(path, os.W_OK):
        pytest.skip("who runs the tests may do everything")
    yield path
    path.chmod(0o644)


def test_a_file_that_cannot_be_written_is_told_before_a_case_is_computed(read_only):
    def study_of(*sizes):
        return study(
            read_only.parent,
            grid(size=sizes),
            lambda size: pytest.fail("began"),
            name="a",
            stale="keep",
        )

    assert len(study_of(1)[0].rows) == 1  # what is there can be looked at
    with pytest.raises(PermissionError, match=r"a\.jsonl"):
        study_of(1, 2)


@pytest.mark.parametrize(
    ("reason", "advice"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "make room, then: cat "),
        (PermissionError(errno.EACCES, "Denied"), "see that the file can be written, then: cat "),
        (ValueError("line 3"), "put the file in order, then: cat "),
    ],
)
def test_the_advice_to_rows_that_are_set_aside_is_that_for_the_reason(tmp_path, reason, advice):
    store = rows.Store(tmp_path / "a.jsonl")
    assert f". They are kept; {advice}" in str(rows.set_aside([(store, ROW)], reason))


@pytest.mark.skipif(os.name != "posix", reason="the advice is for a shell")
def test_rows_that_were_set_aside_are_brought_back_behind_a_line_that_is_cut_off(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text(f"{GOOD}\n{GOOD[:-30]}")
    told = str(rows.set_aside([(rows.Store(path), ROW)], PermissionError(errno.EACCES, "Denied")))
    subprocess.run(told.partition("then: ")[2], shell=True, check=True)
    assert [row.parameters["size"] for row in read(path)] == [1, 2]
    study(tmp_path, grid(size=[2, 3]), lambda size: {"size": size}, name="a", stale="keep")
    assert [row.parameters["size"] for row in read(path)] == [1, 2, 3]


def spoilt(tmp_path):
    """A folder, and a function after which nothing can be written there."""
    folder = tmp_path / "results"

    def compute(size):
        folder.rename(tmp_path / "renamed")
        folder.touch()
        return {"size": size}

    return folder, compute


def test_rows_are_set_aside_when_nothing_can_be_written_any_more(tmp_path):
    folder, compute = spoilt(tmp_path)
    with (
        pytest.warns(StudyWarning, match="cannot be written"),
        pytest.warns(StudyWarning, match=r"1 finished rows could not be written .*They are kept"),
        pytest.raises(OSError, match="results"),
    ):
        study(folder, grid(size=(1, 2)), compute)


def test_a_loop_that_is_left_at_the_last_case_tells_where_its_row_is(tmp_path):
    folder, compute = spoilt(tmp_path)
    coming = ec.study.outcomes(
        [ec.study.Experiment("a", "", compute, [[{"size": 1}]])], folder, workers=0
    )
    with pytest.warns(StudyWarning, match="cannot be written") as unwritten:
        assert next(coming).row
    with pytest.warns(StudyWarning, match="1 finished rows could not be written") as aside:
        coming.close()
    assert {one.filename for one in (*unwritten, *aside)} == {__file__}


def test_a_folder_is_no_file_of_rows_and_numbers_are_no_rows(tmp_path):
    with pytest.raises(ValueError, match=r"^path must be a file, but '.*' is a directory"):
        read(tmp_path)
    with pytest.raises(TypeError, match=r"^rows\[0\] must be a Row, got 1"):
        select([1])


class _Pair(NamedTuple):
    a: int


def test_a_class_of_named_tuples_is_no_result():
    with pytest.raises(TypeError, match="results must be a number"):
        rows.plain("results", _Pair)
