"""Two quick chapters, run as a reader would; ``make test-readers`` runs all."""

import pytest
from readers import chapters, run


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the kernel's client
@pytest.mark.parametrize(("number", "factor"), [("03", "2"), ("15", "4 / 5")])
def test_a_chapter_runs_alone_with_another_degree_and_step(number, factor, monkeypatch):
    monkeypatch.setenv("ESFEM_STRICT", "1")  # of the test, not of the reader
    (path,) = chapters([number])
    changes, _ = run(path, factor)
    assert [change.split()[0] for change in changes] == ["DEGREE", "STEP"]
