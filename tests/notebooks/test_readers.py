"""A quick chapter, run as a reader would; ``make test-readers`` runs all."""

import pytest
from readers import USUAL, chapters, run


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the kernel's client
def test_a_chapter_runs_alone_with_another_degree_and_step(monkeypatch):
    monkeypatch.setenv("ESFEM_STRICT", "1")  # of the test, not of the reader
    (path,) = chapters(["15"])
    changes, _ = run(path, USUAL)
    assert [change.split()[0] for change in changes] == ["DEGREE", "STEP"]
