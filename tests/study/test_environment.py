"""What a row says of the code that made it, and when the book's pages are made again."""

import datetime
import importlib.util
import shutil
from pathlib import Path

import pytest

from esfem_core.study import environment

ROOT = Path(__file__).parents[2]


@pytest.fixture
def checkout(tmp_path):
    """What pages depend on, copied."""
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(environment.PACKAGE, tmp_path / "esfem_core", ignore=without)
    shutil.copy(ROOT / "requirements.lock", tmp_path)
    return tmp_path


def changes(root):
    """Change one thing after another, and tell which."""
    package = root / "esfem_core"
    inner = package / "companion/experiments/theorem.py"
    inner.write_text(inner.read_text("utf8") + "# a comment\n", "utf8")
    yield "a file in a folder of a folder"
    (package / "new.py").touch()
    yield "an empty file"
    (package / "new.py").rename(package / "solvers/new.py")
    yield "its folder"


def test_the_hash_of_a_copy_is_that_of_the_package(checkout):
    assert environment.source_hash(checkout / "esfem_core") == environment.source_hash()
    assert environment.environment()["esfem_core"].endswith(f"source {environment.source_hash()}")


def test_the_hash_sees_every_python_file_and_where_it_stands(checkout):
    package = checkout / "esfem_core"
    hashes = [environment.source_hash(package)]
    for change in changes(checkout):
        hashes.append(environment.source_hash(package))
        assert hashes[-1] not in hashes[:-1], change
    (package / "companion/data/nick_table.jsonl").unlink()
    assert environment.source_hash(package) == hashes[-1]


def test_a_folder_without_source_has_no_hash(tmp_path):
    with pytest.raises(ValueError, match="there is no Python file in"):
        environment.source_hash(tmp_path)


def test_the_date_is_read_each_time(monkeypatch):
    class Later(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return super().now(tz) + datetime.timedelta(days=1)

    today = environment.environment()
    monkeypatch.setattr(environment, "datetime", Later)
    tomorrow = environment.environment()
    assert tomorrow["date"] > today["date"]
    assert tomorrow | {"date": today["date"]} == today


def test_pages_are_made_again_when_code_data_or_pins_change(checkout):
    pytest.importorskip("sphinx")
    spec = importlib.util.spec_from_file_location("cache", ROOT / "book/_ext/package_cache.py")
    cache = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(cache)

    def more_changes():
        yield from changes(checkout)
        for name in (
            "esfem_core/companion/data/nick_table.jsonl",
            "esfem_core/output/viewer.js",
            "requirements.lock",
        ):
            (checkout / name).write_text("")
            yield name

    digests = [cache.digest(checkout)]
    for change in more_changes():
        digests.append(cache.digest(checkout))
        assert digests[-1] not in digests[:-1], change
