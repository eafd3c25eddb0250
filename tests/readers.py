"""Run the chapters as a reader would: downloaded alone, with a degree and a step changed.

    python tests/readers.py [--coarser | --finer] [CHAPTER ...]

Each notebook is executed alone in an empty folder and without ESFEM_STRICT, after DEGREE and STEP
have been changed in its cell of parameters: steps become 4/5 of what they were, so that 1/40 is
1/50 and a time such as 1/4 no multiple any more. With --coarser they are doubled, with --finer
halved. What the chapter states may then fail: it is printed, and the chapter has to go on to its
end. CHAPTER is a number such as 04; without one, all.
"""

import ast
import os
import re
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

BOOK = Path(__file__).parents[1] / "book"
USUAL = "4 / 5"
FACTORS = {"--coarser": "2", "--finer": "1 / 2"}
DIFFERS = re.compile("^differs from the book", re.M)


def chapters(numbers: list[str]) -> list[Path]:
    """Return the notebooks of these chapters, or of all."""
    if not numbers:
        return sorted(BOOK.glob("[0-9][0-9]_*.ipynb"))
    found = {number: sorted(BOOK.glob(f"{number}_*.ipynb")) for number in numbers}
    if unknown := [number for number, paths in found.items() if not paths]:
        raise SystemExit(f"no chapter has the number {', '.join(unknown)}; write 02 for the second")
    return [path for paths in found.values() for path in paths]


def changed(source: str, factor: str = USUAL) -> tuple[str, list[str]]:
    r"""Change DEGREE and STEP in the source of a cell, and return what stands there now.

    Examples
    --------
    >>> changed("DEGREE = 2  # of all elements\nSTEP = 1 / 40\nEND = 1.0")
    ('DEGREE = 3\nSTEP = 4 / 5 * (1 / 40)\nEND = 1.0', ['DEGREE = 3', 'STEP = 4 / 5 * (1 / 40)'])
    """
    lines, found = source.split("\n"), []
    for node in reversed(ast.parse(source).body):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name, value = node.targets[0].id, ast.unparse(node.value)
            new = {
                "DEGREE": f"DEGREE = {3 if value == '2' else 2}",
                "STEP": f"STEP = {factor} * ({value})",
            }.get(name)
            if new:
                lines[node.lineno - 1 : node.end_lineno] = [new]
                found.insert(0, new)
    return "\n".join(lines), found


def run(path: Path, factor: str = USUAL) -> tuple[list[str], int]:
    """Execute a chapter; return what was changed, and how many of its statements then differ."""
    notebook = nbformat.read(path, as_version=4)
    changes: list[str] = []
    for cell in notebook.cells:
        if "parameters" in cell.metadata.get("tags", []):
            cell.source, found = changed(cell.source, factor)
            changes += found
    environment = {k: v for k, v in os.environ.items() if k != "ESFEM_STRICT"}
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(notebook, timeout=1200, kernel_name="python3")
        client.execute(cwd=folder, env=environment)
    printed = [o.get("text", "") for c in notebook.cells for o in c.get("outputs", [])]
    return changes, sum(len(DIFFERS.findall(text)) for text in printed)


def main(arguments: list[str]) -> int:
    """Run them and say what happened; return how many did not come to their end."""
    factor = next((FACTORS[a] for a in arguments if a in FACTORS), USUAL)
    failed = 0
    for path in chapters([a for a in arguments if a not in FACTORS]):
        began = time.perf_counter()
        try:
            changes, differ = run(path, factor)
            said = f"{', '.join(changes) or 'nothing to change'}: {differ} statements differ"
        except CellExecutionError as error:
            failed += 1
            said = f"FAILED\n{error}"
        print(f"{path.stem}: {said} ({time.perf_counter() - began:.0f} s)", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(1 if main(sys.argv[1:]) else 0)
