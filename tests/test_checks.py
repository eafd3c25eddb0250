"""What is refused at the door, and in which words."""

import os
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import esfem_core as ec
from esfem_core import Species
from esfem_core.checks import (
    check_even,
    finite_array,
    flag,
    frozen,
    integer_array,
    number,
    one_of,
    output_path,
    path_of,
    real_array,
    whole_number,
)


@pytest.mark.parametrize(
    "value", [3, 3.0, np.int8(3), np.float32(3), np.array(3), np.array(3.0), Fraction(3)]
)
def test_numbers_of_any_library_with_an_integer_value_are_integers(value):
    found = whole_number("n", value, 1)
    assert found == 3
    assert type(found) is int


@pytest.mark.parametrize("value", [2.5, np.nan, np.inf, 0, -1, 7])
def test_other_numbers_are_no_integers_in_the_range(value):
    with pytest.raises(ValueError, match=r"n must be an integer from 1 to 6, got "):
        whole_number("n", value, 1, 6)


@pytest.mark.parametrize("value", [None, "3", 3j, [3], np.array([3]), np.array([]), True, {}])
def test_what_is_no_number_is_refused_by_name(value):
    with pytest.raises(TypeError, match=r"n must be an integer >= 1, got "):
        whole_number("n", value, 1)
    with pytest.raises(TypeError, match=r"step must be a finite number > 0, got "):
        number("step", value, above=0)


@pytest.mark.parametrize("unit", ["generic", "ns", "s", "D"])
def test_a_time_span_is_no_number(unit):
    span = np.timedelta64(1) if unit == "generic" else np.timedelta64(1, unit)
    for value in (span, np.array(span)):
        with pytest.raises(TypeError, match=r"order must be an integer >= 1, got "):
            whole_number("order", value, 1)
        with pytest.raises(TypeError, match=r"step must be a finite number > 0, got "):
            number("step", value, above=0)
    for values in ([span, span], np.array([span, 1], object)):
        with pytest.raises(TypeError, match="u must hold real numbers, got "):
            real_array("u", values, ("N",))


def test_an_array_without_axes_is_true_or_false():
    for value in (True, np.bool_(True), np.array(True)):
        assert flag("boundary", value) is True
    assert Species(1.0, conserved=np.array(False)).conserved is False
    for value, found in [(np.array(1), "1"), (np.array([True]), r"an array of shape \(1,\)")]:
        with pytest.raises(TypeError, match=f"boundary must be True or False, got {found}"):
            flag("boundary", value)


def test_bounds_are_part_of_the_message():
    assert number("eta", 0, least=0, below=1) == 0.0
    with pytest.raises(ValueError, match=r"eta must be a finite number >= 0 and < 1, got 1"):
        number("eta", 1, least=0, below=1)
    with pytest.raises(ValueError, match=r"share must be a finite number >= 0 and <= 0.3, got 0.5"):
        number("share", 0.5, least=0, most=0.3)
    with pytest.raises(TypeError, match="got Decimal"):
        number("share", Decimal(1))


def test_options_of_a_literal():
    options = Literal["direct", "lifted"]
    assert one_of("evaluation", "lifted", options) == "lifted"
    for value in ("Direct", None, 3, np.array(["direct"])):
        with pytest.raises(ValueError, match=r'evaluation must be "direct" or "lifted", got '):
            one_of("evaluation", value, options)
    with pytest.raises(ValueError, match=r'or "lifted", got an array of shape \(\)'):
        one_of("evaluation", np.array("direct"), options)


def test_arrays_of_a_shape():
    x = np.zeros((4, 3))
    assert real_array("x", x, ("N", 3)) is x
    assert real_array("u", np.zeros((4, 2, 2)), (4, "...")).shape == (4, 2, 2)
    assert real_array("u", np.zeros(4), (4, "...")).shape == (4,)
    assert real_array("x", np.zeros(3), ("...", 3)).shape == (3,)
    assert real_array("x", np.zeros((2, 4, 3)), ("...", 3)).shape == (2, 4, 3)
    for values in (np.zeros((3, 4)), np.zeros(()), np.zeros((2, 3, 4))):
        with pytest.raises(ValueError, match=r"x must have shape \(\.\.\., 3\), got \("):
            real_array("x", values, ("...", 3))
    for values in (np.zeros((3, 4)), np.zeros(3), np.zeros((4, 3, 1)), 1.0, []):
        with pytest.raises(ValueError, match=r"x must have shape \(N, 3\), got \("):
            real_array("x", values, ("N", 3))
    with pytest.raises(ValueError, match=r"x must have shape \(N, 3\), but its rows have none: "):
        real_array("x", [[1, 2, 3], [4]], ("N", 3))


@pytest.mark.parametrize("values", [[1j, 0, 0], ["a", "b", "c"], [None] * 3, [True] * 3])
def test_numbers_that_are_not_real_are_refused(values):
    with pytest.raises(TypeError, match="x must hold real numbers, got "):
        real_array("x", values, (3,))


def test_a_mask_is_not_lost_in_a_list():
    row = np.ma.array([1e9, 1.0], mask=[True, False])
    for values in (row, [row, row], ([0.0, 1.0], row), [[row]], list(row)):
        for check in (check_even, lambda name, given: real_array(name, given, ("...",))):
            with pytest.raises(TypeError, match="u0 must hold real numbers, got a masked array: "):
                check("u0", values)
    endless = []
    endless.append(endless)
    with pytest.raises(
        ValueError, match=r"u0 must have shape \(\.\.\.,\), but its rows have none: "
    ):
        real_array("u0", endless, ("...",))


@pytest.mark.parametrize("error", [TypeError, RuntimeError])
def test_a_library_that_gives_no_array_does_not_keep_the_name_from_the_message(error):
    class Tensor:
        def __array__(self, dtype=None, copy=None):
            raise error("call detach() first")

        def __repr__(self):
            return "Tensor()"

    for check in (check_even, lambda name, given: real_array(name, given, ("N",))):
        with pytest.raises(
            TypeError, match=r"u0 must hold real numbers, got Tensor\(\): call detach\(\) first"
        ):
            check("u0", Tensor())


def test_what_is_not_finite_is_refused_with_its_place():
    with pytest.raises(ValueError, match=r"u must be finite, but u\[2\] is inf"):
        finite_array("u", [0, 1, np.inf], ("N",))


def test_arrays_of_integers_of_any_type():
    for values in ([[1, 2]], np.array([[1, 2]], np.uint8), np.array([[1.0, 2.0]])):
        found = integer_array("faces", values, ("T", 2))
        assert found.dtype == np.int64
        assert found.tolist() == [[1, 2]]
    with pytest.raises(ValueError, match=r"faces must hold integers, but faces\[1\] is 2.5"):
        integer_array("faces", [1, 2.5], ("n",))
    with pytest.raises(ValueError, match=r"faces must be finite, but faces\[0\] is nan"):
        integer_array("faces", [np.nan], ("n",))
    with pytest.raises(TypeError, match="faces must hold real numbers"):
        integer_array("faces", [True], ("n",))


def test_integers_that_a_float_cannot_tell_apart_are_kept_or_refused():
    with pytest.raises(ValueError, match=r"a must hold integers below 2\*\*53, but a\[0\] is"):
        integer_array("a", [float(2**53)], ("n",))
    assert integer_array("a", np.array([2**53 + 1]), ("n",)).tolist() == [2**53 + 1]


class TestPaths:
    """Of files to be written: what open() can write, and nothing else."""

    def refused(self, path, error, message):
        with pytest.raises(error, match=message):
            output_path("save", path, (".npz",))

    def test_what_can_be_nowhere_is_refused_by_name(self, tmp_path):
        (tmp_path / "one.npz").symlink_to("two.npz")
        (tmp_path / "two.npz").symlink_to("one.npz")
        for path, reason in [
            ("a\0.npz", r"'a\\x00\.npz': embedded null byte"),
            ("a" * 300 + ".npz", r"'aaaa.*': File name too long"),
            (str(tmp_path / ("a" * 300) / "run.npz"), ": File name too long"),
            (tmp_path / "one.npz", "one.npz': Too many levels of symbolic links"),
            ("\ud800.npz", r"'\\ud800\.npz': 'utf-8' codec can't encode"),
        ]:
            self.refused(path, ValueError, rf"save must be the path of a file, got .*{reason}")
            with pytest.raises(
                ValueError, match=rf"folder must be the path of a folder, .*{reason}"
            ):
                path_of("folder", path, "a folder")

    @pytest.mark.parametrize("path", [None, 3, b"run.npz", Fraction(1)])
    def test_what_is_no_path_is_refused_by_name(self, path):
        self.refused(path, TypeError, "save must be the path of a file, got ")

    def test_a_home_that_a_shell_would_put_in_is_told_and_no_folder_called_so(
        self, tmp_path, monkeypatch
    ):
        monkeypatch.setenv("HOME", str(tmp_path))
        monkeypatch.chdir(tmp_path)
        space, run = ec.SurfaceSpace(ec.sphere("octahedron")), Path("~/run.npz")
        for use in (
            lambda: ec.save(run, ec.State(0.0, space.nodes, space=space)),
            lambda: ec.load(str(run)),
            lambda: ec.save_table("~/run.csv", [{"t": 0.5}]),
            lambda: ec.SurfaceSpace.read("~/tooth.ply"),
            lambda: ec.study.read("~/sums.jsonl"),
            lambda: ec.study.run([{}], dict, "~/study"),
        ):
            with pytest.raises(
                ValueError, match=r"got '(~/.*)': .*; Path\('\1'\)\.expanduser\(\) "
            ):
                use()
        assert not list(tmp_path.iterdir())
        ec.save(run.expanduser(), ec.State(0.0, space.nodes, space=space))
        assert ec.load(tmp_path / "run.npz")[1][0].t == 0.0
        for path in ("~$run.npz", "a~/run.npz"):  # of editors
            assert str(path_of("path", path, "a file")) == path

    def test_a_parent_that_is_no_directory_is_named(self, tmp_path):
        (tmp_path / "file").touch()
        self.refused(
            tmp_path / "file" / "run.npz",
            NotADirectoryError,
            "save must be in a directory, but '.*file' is a file",
        )
        for deeper in (tmp_path / "none", tmp_path / "none" / "none", tmp_path / "file" / "none"):
            self.refused(deeper / "run.npz", FileNotFoundError, "the directory '.*none' does not")

    def test_a_directory_that_cannot_be_written_to_is_refused(self, tmp_path, monkeypatch):
        asked = []

        def access(path, mode):  # who runs the tests may be root, who may write anywhere
            asked.append((path, mode))
            return False

        monkeypatch.setattr(os, "access", access)
        message = r"save must be in a directory that can be written to, but '.*' cannot; choose an"
        self.refused(tmp_path / "run.npz", PermissionError, message)
        assert asked == [(tmp_path, os.W_OK | os.X_OK)]

    def test_a_file_that_is_write_protected_is_refused(self, tmp_path, monkeypatch):
        path, access = tmp_path / "run.npz", os.access
        path.touch()
        monkeypatch.setattr(  # who runs the tests may be root, who may write anywhere
            os, "access", lambda asked, mode: asked != path and access(asked, mode)
        )
        self.refused(
            path, ValueError, r"save must be a file .*run\.npz' is write-protected; choose"
        )
        output_path("save", tmp_path / "other.npz", (".npz",))

    def test_directories_and_pipes_are_no_files(self, tmp_path):
        (tmp_path / "folder.npz").mkdir()
        os.mkfifo(tmp_path / "pipe.npz")
        self.refused(tmp_path / "folder.npz", ValueError, "save must be a file, but .* directory")
        self.refused(tmp_path / "pipe.npz", ValueError, "save must be a file, but .* a pipe")

    def test_links_are_followed_as_by_open(self, tmp_path):
        link = tmp_path / "link.npz"
        link.symlink_to("target")
        assert output_path("save", link, (".npz",)) == link
        assert path_of("path", link, "a file") == link
        link.unlink()
        link.symlink_to("none/target")
        self.refused(link, FileNotFoundError, "the directory '.*none' does not exist; make it")
        link.unlink()
        link.symlink_to(tmp_path)
        self.refused(link, ValueError, "save must be a file, but .* is a directory")


def test_memory_of_others_is_copied_and_ones_own_and_bytes_are_not(tmp_path):
    np.save(tmp_path / "x.npy", np.ones((2, 3)))
    mapped = np.load(tmp_path / "x.npy", mmap_mode="r")
    kept, part = frozen(real_array("x", mapped, (2, 3))), frozen(mapped[0])
    np.load(tmp_path / "x.npy", mmap_mode="r+")[:] = 0
    assert (mapped[0] == 0).all()
    assert (kept == 1).all()
    assert (part == 1).all()
    own = np.ones(3)
    own.setflags(write=False)
    for good in (own, own[::2], np.frombuffer(bytes(8))):
        assert frozen(good) is good
    shared = np.frombuffer(memoryview(bytearray(8)).toreadonly())
    assert not np.shares_memory(frozen(shared), shared)
