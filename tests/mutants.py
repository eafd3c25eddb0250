"""Faults put into the solver one at a time: `make mutants` says which ones its tests let pass.

A mutant is one change of one place: another comparison, operator, number or condition, swapped
arguments, a statement left out. Docstrings, messages and types are left alone. A seeded sample is
taken from each room and tried with the tests of that room and the examples in its docstrings, in a
copy of the repository. What no test notices survives; CONTRIBUTING.md explains those of the sample.
A mutant that does not end, or asks for more memory than there is, is noticed.
"""

import argparse
import ast
import compileall
import copy
import os
import py_compile
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ROOMS = ("elements", "solvers", "laws", "stepping", "theory")
NEEDED = ("esfem_core", "tests", "examples", "pyproject.toml")  # to run the tests of a room
MEMORY = 6 << 30  # bytes that the tests of a mutant may take
LONGEST = 3600  # seconds of a processor for the tests of a room
NO_TESTS = 5  # of pytest
LEAST = 0.9  # share of mutants that must be killed

OTHERS: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.FloorDiv: (ast.Mult,),
    ast.Pow: (ast.Mult,), ast.Mod: (ast.Mult,), ast.MatMult: (ast.Mult,), ast.BitOr: (ast.BitAnd,),
    ast.BitAnd: (ast.BitOr,), ast.And: (ast.Or,), ast.Or: (ast.And,),
}  # fmt: skip
Change = tuple[ast.AST, str, ast.AST]  # what, how, and what stands there then


class Mutant(NamedTuple):
    """A file with one change in it."""

    file: Path
    line: int
    change: str
    source: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.change}"


def mutants(file: Path) -> list[Mutant]:
    """All mutants of a file of the repository."""
    source = (ROOT / file).read_text("utf8")
    encoded, starts = source.encode(), [0]
    for line in encoded.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    for old, kind, new in _changes(ast.parse(source)):
        first = starts[old.lineno - 1] + old.col_offset
        last = starts[old.end_lineno - 1] + old.end_col_offset
        text = ast.unparse(new)
        before = " ".join(encoded[first:last].decode().split())
        if isinstance(new, ast.expr):
            text = f"({text})"
        changed = (encoded[:first] + text.encode() + encoded[last:]).decode()
        try:
            ast.parse(changed)
        except SyntaxError:
            continue  # such as parentheses around a target
        found.append(Mutant(file, old.lineno, f"{kind}: {before}  ->  {text}", changed))
    return found


def _changes(node: ast.AST) -> Iterator[Change]:
    """All changes in a node and below it, where they are no text and no type."""
    yield from _own(node)
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_text(child):
                yield from _changes(child)


def _is_text(node: ast.AST) -> bool:
    """Whether a node makes text: of a message, or what an object says of itself."""
    match node:
        case ast.FunctionDef(name="__repr__" | "__str__") | ast.JoinedStr():
            return True
        case ast.Constant(value=str()):
            return True
    return False


def _own(node: ast.AST) -> Iterator[Change]:
    """Changes of the node itself."""

    def changed(kind: str, **fields: object) -> Change:
        new = copy.copy(node)
        for name, value in fields.items():
            setattr(new, name, value)
        return node, kind, new

    match node:
        case ast.Compare(ops=[op, *rest]):
            for other in OTHERS[type(op)]:
                yield changed("comparison", ops=[other(), *rest])
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in OTHERS:
            yield changed("operator", op=OTHERS[type(op)][0]())
        case ast.AugAssign(op=op):
            yield changed("operator", op=OTHERS[type(op)][0]())
            yield node, "statement", ast.Pass()
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield node, "sign", operand
        case ast.Constant(value=bool(value)):
            yield changed("constant", value=not value)
        case ast.Constant(value=int(value)):
            yield changed("constant", value=value + 1)
            yield changed("constant", value=value - 1 if value else -1)
        case ast.Constant(value=float(value)):
            yield changed("constant", value=2 * value if value else 1.0)
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
            yield test, "condition", ast.UnaryOp(ast.Not(), test)
        case ast.Call(func=ast.Name("isinstance" | "hasattr")):
            pass
        case ast.Call(args=[first, second, *rest]) if not (_is_text(first) or _is_text(second)):
            if ast.dump(first) != ast.dump(second):
                yield changed("arguments", args=[second, first, *rest])
        case ast.Continue():
            yield node, "statement", ast.Break()
        case ast.Raise() | ast.Break():
            yield node, "statement", ast.Pass()
        case ast.Expr(value=ast.Call() | ast.YieldFrom()):
            yield node, "statement", ast.Pass()


def sample(room: str, n: int, seed: int) -> list[Mutant]:
    """Mutants of a room at random, most of them the same after a change elsewhere in the room."""
    files = sorted((ROOT / "esfem_core" / room).glob("[!_]*.py"))
    found = [mutant for file in files for mutant in mutants(file.relative_to(ROOT))]
    alike: Counter[str] = Counter()
    draws = []
    for mutant in found:
        name = f"{seed} {mutant.file} {mutant.change}"
        draws.append(random.Random(f"{name} {alike[name]}").random())
        alike[name] += 1
    chosen = sorted(range(len(found)), key=draws.__getitem__)[:n]
    return [found[i] for i in sorted(chosen)]


def copied(folder: Path) -> Path:
    """A copy of what the tests need, in a new folder, compiled: only a mutant is compiled again."""
    for name in NEEDED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc"))
        else:
            shutil.copy(ROOT / name, folder)
    checked = py_compile.PycInvalidationMode.CHECKED_HASH
    compileall.compile_dir(folder / "esfem_core", quiet=1, invalidation_mode=checked)
    return folder


def tests(folder: Path, file: Path, seconds: int) -> int:
    """Run the tests of a file's room, at first its own and those that import it.

    They may take so many seconds of a processor, and so may the others.
    """
    _, room, name = file.parts
    module = ".".join(file.with_suffix("").parts)
    importing = [
        str(path.relative_to(folder))
        for path in sorted((folder / "tests" / room).glob("*.py"))
        if module in path.read_text("utf8")
    ]
    names = dict.fromkeys([f"tests/{room}/test_{name}", str(file), *importing])
    own = [path for path in names if (folder / path).exists()]
    rest = [f"tests/{room}", f"esfem_core/{room}", *(f"--ignore={path}" for path in own)]
    command = [sys.executable, "-B", "-P", "-m", "pytest", "-q", "-x", "-m", "not slow"]
    command += ["-p", "no:cacheprovider", "--assert=plain"]
    environment = {"PYTHONPATH": str(folder), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))

    for places in (own, rest):
        ended = subprocess.run(
            [*command, *places],
            cwd=folder,
            env=os.environ | environment,
            capture_output=True,
            check=False,
            preexec_fn=limit,
        )
        if ended.returncode not in (0, NO_TESTS):
            break
    if ended.returncode > 2 and ended.returncode != NO_TESTS:
        raise RuntimeError(f"{file}: pytest ended with {ended.returncode}: {ended.stdout!r}")
    return ended.returncode


def tried(
    chosen: list[Mutant], folders: SimpleQueue[Path], pool: ThreadPoolExecutor
) -> Iterator[tuple[str, Mutant]]:
    """What became of the mutants of a room: killed, hangs or survived."""
    folder, before = folders.get(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    if tests(folder, chosen[0].file, LONGEST) != 0:
        raise RuntimeError(f"the tests of {chosen[0].file.parent} fail without any mutant")
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    folders.put(folder)

    def outcome(mutant: Mutant) -> str:
        folder = folders.get()
        place = folder / mutant.file
        good = place.read_text("utf8")
        try:
            place.write_text(mutant.source, "utf8")
            code = tests(folder, mutant.file, 30 + 3 * round(used))
        finally:
            place.write_text(good, "utf8")
            folders.put(folder)
        return "survived" if code == 0 else "killed" if code > 0 else "hangs"  # or a crash

    yield from zip(pool.map(outcome, chosen), chosen, strict=True)


def main() -> None:
    """Try the sample, and fail if too many survive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="mutants of a room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rooms", nargs="+", default=ROOMS, choices=ROOMS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="files or lines that hold this, as file.py:12")
    options = parser.parse_args()
    if min(options.each, options.workers) < 1:
        parser.error("--each and --workers must be 1 or more")
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(options.workers) as pool:
        folders: SimpleQueue[Path] = SimpleQueue()
        for i in range(options.workers):
            folders.put(copied(Path(place, str(i))))
        for room in options.rooms:
            chosen = [m for m in sample(room, options.each, options.seed) if options.only in str(m)]
            if not chosen:
                continue
            for became, mutant in tried(chosen, folders, pool):
                counts[became] += 1
                print(f"{became:8} {mutant}", flush=True)
    n, killed = counts.total(), counts["killed"] + counts["hangs"]
    print(f"{killed} of {n} mutants killed, {counts['hangs']} of them because they hang")
    sys.exit(killed < LEAST * n or n == 0)


if __name__ == "__main__":
    main()
