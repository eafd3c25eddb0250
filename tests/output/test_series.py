"""Series on disk: read back bit for bit by other programs, whole at any moment."""

import csv
import os
import signal
import subprocess
import sys
from enum import Enum
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import sympy
from full_disk import room

import esfem_core as ec
from esfem_core.stepping import write_whole

NAMES = ["u", 'a<"b">&c', "Größe"]
DEGREES = [1, 2, 3, 4, 5]


def states(degree, names=NAMES):
    """Two states of an ellipsoid, the first without a velocity."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), degree, ec.to_unit_sphere)
    x = space.nodes
    fields = {name: x[:, :m].squeeze() ** 3 / 7 for m, name in enumerate(names, start=1)}
    return [
        ec.State(0.0, x, None, space=space, fields=fields),
        ec.State(1 / 3, x * [1.3, 1, 1 / 7], x / 3, space=space, fields=fields),
    ]


def entries(path):
    """Times and files of a series."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib["type"] == "Collection"
    return [(float(e.attrib["timestep"]), e.attrib["file"]) for e in root.iter("DataSet")]


@pytest.mark.parametrize("degree", DEGREES)
def test_meshio_reads_nodes_elements_and_values_back_bitwise(tmp_path, degree):
    given = states(degree)
    assert ec.save_series(tmp_path / "a run.pvd", given, normals=True) is given[-1]
    assert [t for t, _ in entries(tmp_path / "a run.pvd")] == [0.0, 1 / 3]
    for state, (_, name) in zip(given, entries(tmp_path / "a run.pvd"), strict=True):
        mesh = meshio.read(tmp_path / name)
        [block] = mesh.cells
        assert block.type == "VTK_LAGRANGE_TRIANGLE"
        np.testing.assert_array_equal(block.data, state.space.cells)
        np.testing.assert_array_equal(mesh.points, state.x)
        assert set(mesh.point_data) == {*NAMES, "v", "normals"}
        for key in NAMES:
            np.testing.assert_array_equal(mesh.point_data[key], state[key])
        v = np.full_like(state.x, np.nan) if state.v is None else state.v
        np.testing.assert_array_equal(mesh.point_data["v"], v)
        np.testing.assert_array_equal(mesh.field_data["TimeValue"], [state.t])


@pytest.mark.parametrize("degree", DEGREES)
def test_normals_are_those_of_the_surface_and_of_length_one(tmp_path, degree):
    ec.save_series(tmp_path / "run.pvd", states(degree)[:1], normals=True)
    [(_, name)] = entries(tmp_path / "run.pvd")
    normals = meshio.read(tmp_path / name).point_data["normals"]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-14)
    assert np.abs(normals - states(degree)[0].x).max() < 0.01


@pytest.mark.parametrize("degree", DEGREES)
def test_vtk_reads_it_back_bitwise_and_its_tessellation_has_the_area(tmp_path, degree):
    pyvista = pytest.importorskip("pyvista")
    vtk = pytest.importorskip("vtk")
    given = states(degree)
    ec.save_series(tmp_path / "run.pvd", given)
    reader = pyvista.get_reader(tmp_path / "run.pvd")
    assert reader.time_values == [0.0, 1 / 3]
    for state in given:
        reader.set_active_time_value(state.t)
        grid = reader.read()[0]
        assert (np.asarray(grid.celltypes) == vtk.VTK_LAGRANGE_TRIANGLE).all()
        np.testing.assert_array_equal(
            grid.cells.reshape(len(state.space.cells), -1)[:, 1:], state.space.cells
        )
        np.testing.assert_array_equal(grid.points, state.x)
        for name in NAMES:
            np.testing.assert_array_equal(grid.point_data[name], state[name])
        exact = ec.SurfaceSpace.from_nodes(state.space.nodes, state.space.cells, exactness=30)
        area = exact.integrate(state.x, 1.0)
        tessellated = []
        for level in (3, 4):
            surface = vtk.vtkDataSetSurfaceFilter()
            surface.SetInputData(grid)
            surface.SetNonlinearSubdivisionLevel(level)
            surface.Update()
            tessellated.append(pyvista.wrap(surface.GetOutput()).triangulate().area)
        coarse, fine = tessellated  # errors of second order: a quarter from level to level
        assert fine + (fine - coarse) / 3 == pytest.approx(area, rel=2e-5)  # VTK has floats inside
        if degree > 1:
            assert (fine - area) / (coarse - area) == pytest.approx(0.25, abs=0.02)


def test_the_space_may_change_on_the_way(tmp_path):
    given = [states(1)[0], *states(3)[1:]]
    ec.save_series(tmp_path / "run.pvd", given)
    for state, (_, name) in zip(given, entries(tmp_path / "run.pvd"), strict=True):
        np.testing.assert_array_equal(meshio.read(tmp_path / name).cells[0].data, state.space.cells)


def test_a_series_holds_two_states_of_one_time(tmp_path):
    """As where new triangles are made: both are drawn."""
    one, other = states(1)[0], states(3)[0]
    assert ec.save_series(tmp_path / "run.pvd", [one, other]) is other
    (t, first), (same, second) = entries(tmp_path / "run.pvd")
    assert t == same
    assert first != second
    for state, name in ((one, first), (other, second)):
        assert len(meshio.read(tmp_path / name).points) == len(state.x)


def test_the_series_is_complete_after_each_state(tmp_path):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)

    def watched():
        for n, state in enumerate(ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 0.5)):
            if n:
                listed = entries(tmp_path / "run.pvd")
                assert len(listed) == n
                assert all(len(meshio.read(tmp_path / name).points) for _, name in listed)
            yield state

    last = ec.save_series(tmp_path / "run.pvd", watched())
    assert last.t == 0.5
    assert sorted(os.listdir(tmp_path)) == ["run.pvd", *(f"run_{n:05d}.vtu" for n in range(6))]


KILLED = """
import os, signal, sys
import esfem_core as ec
space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
def kill(at):
    if at.t > 0.42:
        os.kill(os.getpid(), signal.SIGKILL)
    return 0.0
problem = ec.Problem(1.0, kill, motion=lambda p, t: p * (1 + t))
ec.save_series(sys.argv[1], ec.evolve(space, problem, 2, 0.1, 1.0))
"""


def test_a_killed_run_leaves_a_series_that_can_be_read_and_gone_on_with(tmp_path):
    path = tmp_path / "run.pvd"
    environment = os.environ | {"PYTHONPATH": str(Path(ec.__file__).parents[1])}
    killed = subprocess.run([sys.executable, "-c", KILLED, path], env=environment)
    assert killed.returncode == -signal.SIGKILL
    assert [t for t, _ in entries(path)] == [0.0, 0.1, 0.2, 0.3, 0.4]
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    problem = ec.Problem(1.0, motion=lambda p, t: p * (1 + t))
    rest = list(ec.evolve(space, problem, 2, 0.1, 0.7))[3:]  # from 0.3 on
    ec.save_series(path, rest, go_on=True)
    assert [t for t, _ in entries(path)] == [n / 10 for n in range(8)]
    for t, name in entries(path):
        assert meshio.read(tmp_path / name).points.max() == pytest.approx(1 + t)


def test_a_run_that_changes_the_working_folder_writes_to_one_place(tmp_path, monkeypatch):
    one, two = tmp_path / "one", tmp_path / "two"
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    for folder in (two, one):
        folder.mkdir()
        monkeypatch.chdir(folder)
    series, table = ec.SeriesWriter("run.pvd"), ec.TableWriter("run.csv")
    run = ec.evolve(space, ec.problems.growing_sphere(), 1, 0.1, 0.3, save="run.npz", every=1)
    for state in run:
        series.write(state)
        table.write({"t": state.t})
        monkeypatch.chdir(two)
    monkeypatch.chdir(one)

    def elsewhere():
        yield state
        monkeypatch.chdir(two)

    ec.save("last.npz", elsewhere())
    assert not list(two.iterdir())
    assert [name for _, name in entries(one / "run.pvd")] == [f"run_{n:05d}.vtu" for n in range(4)]
    assert (one / "run.csv").read_text() == "t\n0.0\n0.1\n0.2\n0.3\n"
    assert ec.load(one / "run.npz")[1][-1].t == ec.load(one / "last.npz")[1][-1].t == 0.3


def test_a_series_refuses_what_it_cannot_write(tmp_path):
    first, second = states(2)
    plain = ec.State(0.5, first.x, space=first.space)
    for path, given, error, message in [
        ("run.vtk", [first], ValueError, r'path must end with "\.pvd"'),
        ("none/run.pvd", [first], FileNotFoundError, "does not exist; make it first"),
        ("run.pvd", [], ValueError, "at least one state, got none"),
        ("run.pvd", [3], TypeError, r"states\[0\] must be a State, got 3"),
        ("run.pvd", [ec.State(0.0, first.x)], ValueError, "must know its space"),
        ("run.pvd", [first, plain], ValueError, r"same functions, .* has none, the one before 'u'"),
        ("run.pvd", [second, first], ValueError, "order of time, got 0.0 after"),
        ("run.pvd", states(1, ["v"]), ValueError, "must not be called 'v'"),
    ]:
        with pytest.raises(error, match=message):
            ec.save_series(tmp_path / path, given)
    (tmp_path / "run.pvd").write_text("<VTKFile>")
    with pytest.raises(ValueError, match=r"run\.pvd' is damaged, or no series"):
        ec.save_series(tmp_path / "run.pvd", [first], go_on=True)


def test_a_series_that_goes_on_never_takes_the_name_of_a_file_that_it_keeps(tmp_path):
    one, path = states(1)[0], tmp_path / "run.pvd"
    run = [ec.State(t, (1 + t) * one.x, None, space=one.space) for t in (0.0, 1.0, 2.0)]
    ec.save_series(path, run[:2])
    first = '    <DataSet timestep="0.0" part="0" file="run_00000.vtu"/>\n'
    path.write_text(path.read_text("utf8").replace(first, ""), "utf8")  # by hand
    ec.save_series(path, run[2:], go_on=True)
    assert entries(path) == [(1.0, "run_00001.vtu"), (2.0, "run_00002.vtu")]
    np.testing.assert_array_equal(meshio.read(tmp_path / "run_00001.vtu").points, run[1].x)


def test_a_series_goes_on_with_the_functions_that_it_has(tmp_path):
    one, path = states(1)[0], tmp_path / "run.pvd"
    pair = {"u": one.x[:, 0], "pair": one.x[:, :2]}

    def at(t, fields):
        return ec.State(t, one.x, None, space=one.space, fields=fields)

    ec.save_series(path, [at(0.0, pair)])
    before = path.read_bytes()
    message = r"same functions, .* t = 1 .* .*00000\.vtu' 'u' \(1\), 'pair' \(2\), 'v' \(3\)$"
    for fields, normals in [({"w": one.u}, False), ({"u": one.x}, False), (pair, True)]:
        with pytest.raises(ValueError, match=message):
            ec.save_series(path, [at(1.0, fields)], normals=normals, go_on=True)
    assert (path.read_bytes(), len(os.listdir(tmp_path))) == (before, 2)
    ec.save_series(path, [at(1.0, dict(reversed(pair.items())))], go_on=True)
    ec.save_series(path, [at(0.0, {"w": one.x[:, 0]})], go_on=True)  # nothing is kept
    assert [t for t, _ in entries(path)] == [0.0]


def test_a_series_goes_on_without_files_that_are_gone_and_says_so(tmp_path):
    one, path = states(1)[0], tmp_path / "run.pvd"
    run = [ec.State(float(t), one.x, None, space=one.space) for t in range(8)]
    ec.save_series(path, run[:6])
    (tmp_path / "run_00001.vtu").unlink()
    with pytest.warns(ec.EvolutionWarning, match=r"run\.pvd' .* gone: run_00001\.vtu; the series"):
        ec.save_series(path, run[6:7], go_on=True)
    assert [t for t, _ in entries(path)] == [0.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    for n in (0, 3, 4, 5, 6):
        (tmp_path / f"run_{n:05d}.vtu").unlink()
    message = r"gone: run_00000\.vtu, run_00003\.vtu, run_00004\.vtu and 1 more;"
    with pytest.warns(ec.EvolutionWarning, match=message):
        ec.save_series(path, run[6:], go_on=True)  # that of t = 6 is not kept
    assert entries(path) == [
        (2.0, "run_00002.vtu"), (6.0, "run_00003.vtu"), (7.0, "run_00004.vtu")
    ]  # fmt: skip


@pytest.mark.parametrize("data", [b"junk", b"", b"<VTKFile>", b"\x00\xff"])
def test_a_series_does_not_go_on_from_a_file_that_is_damaged(tmp_path, data):
    given, path = states(1), tmp_path / "run.pvd"
    ec.save_series(path, given[:1])
    (tmp_path / "run_00000.vtu").write_bytes(data)
    before = path.read_bytes()
    with pytest.raises(
        ValueError, match=r"lists '.*run_00000\.vtu', which cannot be read \(.*line"
    ):
        ec.save_series(path, given[1:], go_on=True)
    assert path.read_bytes() == before
    ec.save_series(path, given[:1], go_on=True)  # nothing is kept
    assert meshio.read(tmp_path / "run_00000.vtu").points.shape == given[0].x.shape


def test_files_of_other_programs_with_parts_or_groups_lose_none(tmp_path):
    given, path = states(1), tmp_path / "run.pvd"
    ec.save_series(path, given[:1])
    plain = path.read_text("utf8")
    for attributes in ('part="1"', 'part="0" group="left"'):
        path.write_text(text := plain.replace('part="0"', attributes), "utf8")
        with pytest.raises(ValueError, match=r"run\.pvd' lists parts or groups"):
            ec.SeriesWriter(path, go_on=True)
        assert path.read_text("utf8") == text
    for attributes in ("", 'group="" part="0"'):
        path.write_text(plain.replace('part="0"', attributes), "utf8")
        ec.save_series(path, given[1:], go_on=True)
        assert [t for t, _ in entries(path)] == [0.0, 1 / 3]


def test_a_list_is_no_link_into_another_folder(tmp_path):
    (tmp_path / "store").mkdir()
    link = tmp_path / "run.pvd"
    link.symlink_to("store/real.pvd")
    with pytest.raises(ValueError, match=r"no link .*run\.pvd', .*real\.pvd': give that path"):
        ec.SeriesWriter(link)
    assert not list((tmp_path / "store").iterdir())
    (tmp_path / "folder").symlink_to("store")
    link.unlink()
    link.symlink_to("real.pvd")
    for path in (tmp_path / "folder" / "run.pvd", link):
        ec.save_series(path, states(1)[:1])
        [(_, name)] = entries(path)
        assert (path.resolve().parent / name).is_file()


def test_the_file_of_a_state_that_is_write_protected_is_left_with_its_list(tmp_path, monkeypatch):
    path, access = tmp_path / "run.pvd", os.access
    ec.save_series(path, states(1))
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    monkeypatch.setattr(  # who runs the tests may be root, who may write anywhere
        os, "access", lambda asked, mode: Path(asked).suffix != ".vtu" and access(asked, mode)
    )
    with pytest.raises(ValueError, match=r"file of a state .*run_00000\.vtu' is write-protected"):
        ec.save_series(path, states(2))
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_the_list_of_a_long_series_is_not_formatted_again(tmp_path, monkeypatch):
    one, formatted = states(1)[0], []

    def escape(name):
        formatted.append(name)
        return name

    series = ec.SeriesWriter(tmp_path / "run.pvd")
    monkeypatch.setattr("esfem_core.output.series.escape", escape)
    for t in range(20):
        series.write(ec.State(float(t), one.x, None, space=one.space))
    assert len([name for name in formatted if name.endswith(".vtu")]) == 20
    assert [t for t, _ in entries(tmp_path / "run.pvd")] == list(range(20))


@pytest.mark.parametrize(
    "text",
    [
        "<svg/>",
        '<VTKFile type="UnstructuredGrid"/>',
        '<VTKFile type="Collection"><DataSet timestep="nan" file="a.vtu"/></VTKFile>',
        '<?xml version="1.0" encoding="none"?><VTKFile type="Collection"/>',
    ],
)
def test_a_series_goes_on_from_no_other_file(tmp_path, text):
    path = tmp_path / "run.pvd"
    path.write_text(text, "utf8")
    with pytest.raises(ValueError, match=r"run\.pvd' is damaged, or no series"):
        ec.save_series(path, states(1), go_on=True)
    assert path.read_text("utf8") == text


@pytest.mark.parametrize("name", ["", "a\nb", "a\0b", "\ud800", "\uffff"])
def test_a_name_that_xml_cannot_hold_is_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(ValueError, match="the name of a function must be of characters that XML"):
        ec.save_series(tmp_path / "run.pvd", states(1, [name]))
    if name not in ("", "a\0b", "\ud800"):  # these make no path
        with pytest.raises(ValueError, match="the name of path must be of characters that XML"):
            ec.save_series(f"{tmp_path}/{name}.pvd", states(1))
    assert not list(tmp_path.iterdir())


class Row(NamedTuple):
    t: float
    steps: int
    centre: np.ndarray
    amounts: dict
    missing: float | None = None


@pytest.mark.parametrize("text", ["x\ry", "x\r", "x\r\n", "\n", 'a "b", c', ""])
def test_text_is_read_back_in_one_row(tmp_path, text):
    ec.save_table(tmp_path / "run.csv", [{"a": text, text or "b": 1}, {"a": "z", text or "b": 2}])
    with (tmp_path / "run.csv").open(newline="", encoding="utf8") as file:
        assert list(csv.reader(file)) == [["a", text or "b"], [text, "1"], ["z", "2"]]


def test_rows_are_read_back_with_all_digits(tmp_path):
    rows = [
        Row(n / 3, n, np.array([0.1, 1e-300, n / 7]), {"u": np.float64(n) / 9, "w": np.ones(2)})
        for n in range(4)
    ]
    ec.save_table(tmp_path / "run.csv", iter(rows))
    with (tmp_path / "run.csv").open(newline="", encoding="utf8") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == [
        "t", "steps", "centre_0", "centre_1", "centre_2", "amounts_u", "amounts_w_0",
        "amounts_w_1", "missing",
    ]  # fmt: skip
    for row, line in zip(rows, read, strict=True):
        assert float(line["t"]) == row.t
        assert int(line["steps"]) == row.steps
        assert [float(line[f"centre_{i}"]) for i in range(3)] == row.centre.tolist()
        assert float(line["amounts_u"]) == row.amounts["u"]
        assert line["missing"] == ""


def test_members_of_an_enum_are_written_as_what_they_are(tmp_path):
    class Mass(str, Enum):  # noqa: UP042
        NEW = "new"

    class Order(int, Enum):
        TWO = 2

    class Step(float, Enum):
        TENTH = 0.1

    row = {Mass.NEW: Mass.NEW, "n": Order.TWO, "steps": [Step.TENTH], "by": {Mass.NEW: True}}
    ec.save_table(tmp_path / "a.csv", [row])
    assert (tmp_path / "a.csv").read_text() == "new,n,steps_0,by_new\nnew,2,0.1,True\n"


def test_a_table_is_complete_after_each_row_and_refuses_other_columns(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("old")
    table = ec.TableWriter(path)
    assert path.read_text() == "old"
    table.write({"t": 0.5})
    assert path.read_text() == "t\n0.5\n"
    for row, error, message in [
        ({"s": 1.0}, ValueError, "rows must all have the columns t; got s"),
        ([1.0], TypeError, "row must be a mapping from names to numbers, got"),
        (Row, TypeError, "row must be a mapping from names to numbers, got the class Row"),
        ({}, ValueError, "row must have at least one column, got {}"),
    ]:
        with pytest.raises(error, match=message):
            table.write(row)
    assert path.read_text() == "t\n0.5\n"
    with pytest.raises(ValueError, match="at least one row"):
        ec.save_table(path, [])


def test_a_full_disk_leaves_a_table_whole_that_goes_on_when_there_is_room(tmp_path):
    path = tmp_path / "run.csv"
    table = ec.TableWriter(path)
    table.write({"t": 0.1, "a": 0.25})
    message = "it is whole up to the row before: make room, and write again"
    with room(14), pytest.raises(OSError, match=message):
        table.write({"t": 0.2, "a": 0.5})
    assert path.read_text() == "t,a\n0.1,0.25\n"
    table.write({"t": 0.2, "a": 0.5})
    assert path.read_text() == "t,a\n0.1,0.25\n0.2,0.5\n"
    with room(3), pytest.raises(OSError, match="the file is as it was: make room"):
        ec.TableWriter(path).write({"t": 0.3})
    assert path.read_text() == "t,a\n0.1,0.25\n0.2,0.5\n"


def test_a_table_that_is_write_protected_meanwhile_is_told_and_goes_on_without(
    tmp_path, monkeypatch
):
    table = ec.TableWriter(tmp_path / "run.csv")
    table.write({"t": 0.1})

    def protected(*given, **options):  # who runs the tests may be root, who may write anywhere
        raise PermissionError(13, "Permission denied")

    message = r"Permission denied; it is whole up to the row before: see that it can be written to,"
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", protected)
        patch.setattr(os, "truncate", protected)
        with pytest.raises(PermissionError, match=message) as told:
            table.write({"t": 0.2})
    assert told.value.filename == str(table.path)
    table.write({"t": 0.2})
    assert table.path.read_text() == "t\n0.1\n0.2\n"


def test_a_full_disk_leaves_a_series_complete_up_to_the_state_before(tmp_path):
    first, second = states(1)
    series = ec.SeriesWriter(tmp_path / "run.pvd")
    series.write(first)
    before = (tmp_path / "run.pvd").read_text()
    with room(100), pytest.raises(OSError, match="the file is as it was: make room"):
        series.write(second)
    assert (tmp_path / "run.pvd").read_text() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["run.pvd", "run_00000.vtu"]
    series.write(second)
    assert (tmp_path / "run.pvd").read_text().count("DataSet") == 2


@pytest.mark.parametrize(("go_on", "kept"), [(False, []), (True, [0.0])])
def test_a_series_never_lists_files_of_another_run(tmp_path, monkeypatch, go_on, kept):
    one, path = states(1)[0], tmp_path / "run.pvd"
    run = [ec.State(t, one.x, None, one.u, space=one.space) for t in (0.0, 1.0, 2.0)]
    ec.save_series(path, run)
    listed = []

    def write(file, data):
        write_whole(file, data)
        listed.append([t for t, _ in entries(path)])

    monkeypatch.setattr("esfem_core.output.series.write_whole", write)
    new = ec.State(0.5, 2 * one.x, None, one.u, space=one.space)
    ec.save_series(path, [new], go_on=go_on)
    assert listed == [kept, kept, [*kept, 0.5]]
    assert sorted(os.listdir(tmp_path))[1:] == [f"run_{n:05d}.vtu" for n in range(3)]


@pytest.mark.parametrize("bad", [1j, np.array([b"a"]), object()])
def test_a_row_of_what_is_no_number_is_refused_by_column(tmp_path, bad):
    with pytest.raises(TypeError, match="row must hold real numbers, text or None, but 'b"):
        ec.TableWriter(tmp_path / "run.csv").write({"a": 1.0, "b": bad})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("row", "error", "message"),
    [
        ({"a": [1, 2], "a_0": 3}, ValueError, "different columns, got two called 'a_0'"),
        ({"a": {"b": 1}, "a_b": 3}, ValueError, "different columns, got two called 'a_b'"),
        ({"a": np.ma.array([1.0, 2.0], mask=[0, 1])}, TypeError, "'a' is masked"),
        ({"a": np.ma.masked}, TypeError, "'a' is masked"),
        ({"a": np.timedelta64(5, "ns")}, TypeError, "but 'a' is 5"),
        ({"a": np.array([5], "datetime64[ns]")}, TypeError, "but 'a_0' is 1970-01-01T"),
        ({"a": np.array(5, "timedelta64[ns]")}, TypeError, "but 'a' is 5"),
        ({"a": 1, "v": []}, ValueError, "must hold a number or more in 'v', got none"),
        ({"a": Fraction(10**400, 3)}, ValueError, "below 1.8e308, but 'a' is Fraction"),
        ({"a": sympy.Float("1e400")}, ValueError, "below 1.8e308, but 'a' is 1"),
        ({"a": 1, "b": "x\ud800"}, ValueError, r"rows\[0\] .* column 'b' has 'x\\ud800': half a"),
        ({"\udfff": 1}, ValueError, r"rows\[0\] .* column '\\udfff' has '\\udfff': half a char"),
    ],
)
def test_no_number_of_a_row_is_lost_or_made_up(tmp_path, row, error, message):
    with pytest.raises(error, match=message):
        ec.save_table(tmp_path / "run.csv", [row])
    assert not list(tmp_path.iterdir())


def test_fractions_are_written_as_numbers_that_other_programs_read(tmp_path):
    ec.save_table(tmp_path / "run.csv", [{"t": Fraction(1, 8), "n": 3, "none": {}}])
    assert (tmp_path / "run.csv").read_text() == "t,n\n0.125,3\n"
    ec.save_table(tmp_path / "run.csv", [{"t": sympy.Float(1 / 3), "n": sympy.Integer(10**20)}])
    assert (tmp_path / "run.csv").read_text() == f"t,n\n{1 / 3},{10**20}\n"


def test_a_table_that_was_removed_on_the_way_is_not_begun_anew(tmp_path):
    table = ec.TableWriter(tmp_path / "run.csv")
    table.write({"t": 1.0})
    table.path.unlink()
    with pytest.raises(FileNotFoundError, match=r"removed since its first row.*run\.csv"):
        table.write({"t": 2.0})
    assert not list(tmp_path.iterdir())


WRITES = "something else, such as another run, writes to it, too: choose another path.*run"


@pytest.mark.parametrize("go_on", [False, True])
def test_a_series_does_not_mix_with_that_of_another_run(tmp_path, go_on):
    """Files of both were listed in turn, and those of the one replaced by those of the other."""
    one, path = states(1)[0], tmp_path / "run.pvd"
    first, second, later = (
        [ec.State(t, r * one.x, space=one.space) for t in (0.0, 0.1)] for r in (1, 2, 3)
    )
    series, late = ec.SeriesWriter(path), ec.SeriesWriter(path, go_on=go_on)
    series.write(first[0])
    with pytest.raises(FileExistsError, match=WRITES):
        late.write(second[0])
    series.write(first[1])
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    assert [len(before), *(t for t, _ in entries(path))] == [3, 0.0, 0.1]
    ec.save_series(path, later)  # as a run that is begun anew
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(FileExistsError, match=WRITES):
        series.write(ec.State(0.2, one.x, space=one.space))
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before
    path.unlink()
    again = ec.SeriesWriter(path)
    again.write(first[0])
    path.unlink()
    again.write(first[1])
    assert [t for t, _ in entries(path)] == [0.0, 0.1]


def test_a_table_does_not_mix_with_that_of_another_run(tmp_path):
    """Rows of both stood below the header of one."""
    path = tmp_path / "run.csv"
    table, late = ec.TableWriter(path), ec.TableWriter(path)
    table.write({"t": 0, "u": 1})
    with pytest.raises(FileExistsError, match=WRITES):
        late.write({"t": 0, "w": 2})
    table.write({"t": 1, "u": 1})
    ec.save_table(path, [{"t": 0, "w": 2}])
    for _ in range(2):
        with pytest.raises(FileExistsError, match=WRITES):
            table.write({"t": 2, "u": 1})
        assert path.read_text() == "t,w\n0,2\n"
