"""Files that several writers, interruptions and long names leave whole."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from esfem_core.stepping import write_whole


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_of_writers_at_once_one_whole_version_is_there(tmp_path):
    path = tmp_path / "run.npz"
    versions = [bytes([letter]) * (1 + 10_000 * letter) for letter in range(8)]
    start = threading.Barrier(len(versions))

    def write(data):
        start.wait()
        for _ in range(5):
            write_whole(path, data)
            assert path.read_bytes() in versions

    with ThreadPoolExecutor(len(versions)) as pool:
        list(pool.map(write, versions))
    assert path.read_bytes() in versions
    assert names(tmp_path) == ["run.npz"]


def test_of_processes_at_once_one_whole_version_is_there(tmp_path):
    path = tmp_path / "run.npz"
    write = (
        "import runpy, sys, pathlib; write = runpy.run_path(sys.argv[1])['write_whole']\n"
        "for _ in range(50): write(pathlib.Path(sys.argv[2]), sys.argv[3].encode() * 30_000)"
    )
    source = sys.modules[write_whole.__module__].__file__
    writers = [
        subprocess.Popen([sys.executable, "-c", write, source, path, letter]) for letter in "abcd"
    ]
    assert [writer.wait() for writer in writers] == [0, 0, 0, 0]
    assert path.read_bytes() in [letter * 30_000 for letter in (b"a", b"b", b"c", b"d")]
    assert names(tmp_path) == ["run.npz"]


def test_who_comes_while_another_writes_finds_nothing_of_it(tmp_path, monkeypatch):
    path, fsync = tmp_path / "run.npz", os.fsync

    def another_comes(file):
        monkeypatch.setattr(os, "fsync", fsync)
        write_whole(path, b"the second")
        assert path.read_bytes() == b"the second"
        fsync(file)

    monkeypatch.setattr(os, "fsync", another_comes)
    write_whole(path, b"the first one")
    assert path.read_bytes() == b"the first one"
    assert names(tmp_path) == ["run.npz"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt(), OSError(28, "No space left")])
def test_what_is_unfinished_is_removed(tmp_path, monkeypatch, interruption):
    path = tmp_path / "run.npz"
    write_whole(path, b"old")

    def interrupted(file):
        raise interruption

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(type(interruption)):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["run.npz"]


def test_a_folder_that_is_gone_is_named(tmp_path):
    with pytest.raises(OSError, match=r"the file is as it was: .*run\.npz"):
        write_whole(tmp_path / "gone" / "run.npz", b"")
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"the file is as it was: .*run\.npz"):
        write_whole(tmp_path / "file" / "run.npz", b"")


def test_a_file_that_is_write_protected_stays(tmp_path, monkeypatch):
    path, access = tmp_path / "run.npz", os.access
    write_whole(path, b"kept")
    (tmp_path / "link").symlink_to("run.npz")
    monkeypatch.setattr(  # who runs the tests may be root, who may write anywhere
        os, "access", lambda asked, mode: asked != path and access(asked, mode)
    )
    message = r"It is write-protected; the file is as it was: choose another place: .*run\.npz"
    for name in ("run.npz", "link"):
        with pytest.raises(PermissionError, match=message):
            write_whole(tmp_path / name, b"new")
    assert path.read_bytes() == b"kept"
    assert names(tmp_path) == ["link", "run.npz"]
    write_whole(tmp_path / "other.npz", b"new")


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_permissions_are_those_of_any_new_file(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_whole(tmp_path / "ours", b"")
        (tmp_path / "any").touch()
    finally:
        os.umask(before)
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "any").stat().st_mode


@pytest.mark.skipif(os.name != "posix", reason="Windows has other permissions")
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_a_file_has_the_permissions_of_the_one_whose_place_it_takes_before_it_takes_it(
    tmp_path, monkeypatch, mode
):
    path, fsync, seen = tmp_path / "ours", os.fsync, []

    def look(file):
        seen.append(os.fstat(file).st_mode & 0o777)
        fsync(file)

    monkeypatch.setattr(os, "fsync", look)
    path.touch()
    path.chmod(mode)
    (tmp_path / "link").symlink_to("ours")
    for name in ("ours", "link"):
        write_whole(tmp_path / name, b"secret")
    assert [*seen, path.stat().st_mode & 0o777] == [mode] * 3


@pytest.mark.skipif(os.name != "posix", reason="Windows has other groups")
def test_a_file_has_the_group_of_the_one_whose_place_it_takes(tmp_path):
    own = os.getegid()
    others = [own + 1] if os.geteuid() == 0 else [group for group in os.getgroups() if group != own]
    if not others:
        pytest.skip("who runs the tests is in one group only")
    path = tmp_path / "shared"
    path.touch(0o660)
    os.chown(path, -1, others[0])
    write_whole(path, b"for all of the group")
    assert path.stat().st_gid == others[0]


@pytest.mark.skipif(os.name != "posix", reason="Windows has other groups")
def test_a_file_is_written_where_the_system_does_not_give_it_the_group(tmp_path, monkeypatch):
    asked = []

    def refuse(file, user, group):
        asked.append((user, group, Path(file).stat().st_mode & 0o777))
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "chown", refuse)
    path, umask = tmp_path / "shared", os.umask(0o077)
    try:
        path.touch()
        path.chmod(0o660)
        write_whole(path, b"done")
    finally:
        os.umask(umask)
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"done", 0o660)
    assert asked == [(-1, path.stat().st_gid, 0o600)]  # before others may read it


def test_a_name_as_long_as_a_name_may_be(tmp_path):
    path = tmp_path / ("n" * 251 + ".npz")
    write_whole(path, b"done")
    assert names(tmp_path) == [path.name]


def test_a_link_stays_a_link_also_to_a_file_that_is_not_there_yet(tmp_path):
    link, target = tmp_path / "link.npz", tmp_path / "target"
    link.symlink_to(target.name)
    for data in (b"one", b"two"):
        write_whole(link, data)
        assert link.readlink() == Path("target")
        assert target.read_bytes() == data
