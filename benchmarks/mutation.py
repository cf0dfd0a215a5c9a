"""Do the short tests of a room notice small faults in it? `python -m benchmarks.mutation identification/fit`.

A mutant is the room with one fault: an exchanged comparison or operator, another constant, a forced condition, a
missing statement. In a copy of the checkout, with a cache of its own, the tests that execute its line run, fastest
first, then the rest of their files. It survives if all pass, or if no test executes its line. A line that runs when
its file is imported, or whose source is compiled, is tested by all tests of the file's functions, or of the room.
`--against` measures another checkout. Needs coverage.py, which comes with the extra `checks`.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks.common import at_least_one, parser

SHORT: Final = "not ros and not long"
SLOWER: Final = 20.0
"""A mutant that takes so many times the CPU time of the right code, and LATEST more, is killed: it has no end."""
LATEST: Final = 120.0
"""s."""
PLUGIN: Final = """
import inspect, json, os
import coverage, pytest

seconds, failed, sources, read = {}, set(), [], inspect.getsource

def getsource(thing):
    text = read(thing)
    first = getattr(getattr(thing, "__code__", None), "co_firstlineno", None)
    if first is not None:
        sources.append((inspect.getsourcefile(thing), first, first + text.count("\\n")))
    return text

inspect.getsource = getsource

@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    coverage.Coverage.current().switch_context(item.nodeid)
    started = sum(os.times()[:4])
    yield
    seconds[item.nodeid] = sum(os.times()[:4]) - started
    coverage.Coverage.current().switch_context("")

def pytest_runtest_logreport(report):
    if report.failed or report.skipped:
        failed.add(report.nodeid)

def pytest_sessionfinish():
    found = {"seconds": {name: took for name, took in seconds.items() if name not in failed}, "sources": sources}
    with open(os.environ["MUTATION_FOUND"], "w") as file:
        json.dump(found, file)
"""
"""For pytest: which test runs, the CPU time of each that passed, and of which functions somebody read the source."""
EXCHANGED: Final[dict[type[ast.AST], type[ast.AST]]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
REVERSED: Final[dict[type[ast.AST], type[ast.AST]]] = {
    ast.Lt: ast.Gt,
    ast.LtE: ast.GtE,
    ast.Gt: ast.Lt,
    ast.GtE: ast.LtE,
}


class Mutant(NamedTuple):
    """One fault: the file, its line and those that run with it, what the fault is, and the text of the file with it.

    A line outside of functions runs when the file is imported.
    """

    path: str
    line: int
    lines: frozenset[int]
    is_imported: bool
    words: str
    text: str


class Known(NamedTuple):
    """What the short tests do with the code that is right: CPU s of each, and who executes each line of each file."""

    seconds: dict[str, float]
    lines: dict[str, dict[int, set[str]]]
    sources: list[tuple[str, int, int]]

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Those that may notice a fault: who executes it, fastest first, then the others of their files."""
        lines = self.lines.get(mutant.path, {})
        own: set[str] = set().union(*(lines.get(line, set()) for line in mutant.lines))
        if mutant.is_imported or self._is_compiled(mutant):
            own = set().union(*lines.values()) & self.seconds.keys() or set(self.seconds)
        own &= self.seconds.keys()
        files = {test.partition("::")[0] for test in own}
        others = {test for test in self.seconds if test.partition("::")[0] in files} - own
        return [*sorted(own, key=self.seconds.__getitem__), *sorted(others, key=self.seconds.__getitem__)]

    def _is_compiled(self, mutant: Mutant) -> bool:
        return any(path == mutant.path and first <= mutant.line <= last for path, first, last in self.sources)


def faults(node: ast.AST) -> Iterator[tuple[str, ast.AST | None]]:
    """What may take a node's place, in words, and itself; None leaves a statement out."""
    match node:
        case ast.Compare(ops=[op]):
            for table in (EXCHANGED, REVERSED):
                if other := table.get(type(op)):
                    yield f"{type(op).__name__} → {other.__name__}", replaced(node, ops=[other()])
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op) if other := EXCHANGED.get(type(op)):
            yield f"{type(op).__name__} → {other.__name__}", replaced(node, op=other())
            if isinstance(node, ast.AugAssign):
                yield "statement left out", None
        case ast.Constant(value=bool(value)):
            yield f"{value} → {not value}", ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            near = value + 1 if isinstance(value, int) else 1.1 * value or 0.1
            yield f"{value} → {near:g}", ast.Constant(near)
            if value:
                yield f"{value} → −{value}", ast.UnaryOp(ast.USub(), node)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield f"{type(node.op).__name__} left out", operand
        case ast.If() | ast.IfExp():
            yield from ((f"condition is {value}", replaced(node, test=ast.Constant(value))) for value in (True, False))
        case ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Subscript() | ast.Attribute()]) | ast.Raise():
            yield "statement left out", None
        case ast.Return(value=(ast.Compare() | ast.BoolOp()) as value):
            yield "returns the opposite", replaced(node, value=ast.UnaryOp(ast.Not(), value))


def replaced(node: ast.AST, **fields: object) -> ast.AST:
    """A copy of a node with other fields."""
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return other


class Place(NamedTuple):
    """A node of a file's tree that may be exchanged: its parent, its field there and its place in a list."""

    node: ast.AST
    parent: ast.AST
    field: str
    place: int | None
    statement: ast.stmt
    is_imported: bool

    def put(self, node: ast.AST) -> None:
        """Let another node, or the right one, stand here."""
        if self.place is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.place] = node


def places(tree: ast.AST, statement: ast.stmt, is_imported: bool = True) -> Iterator[Place]:
    """All below a node, but types and the texts of f-strings."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns", "decorator_list") or isinstance(tree, ast.JoinedStr):
            continue
        inside = is_imported and not (isinstance(tree, ast.FunctionDef | ast.AsyncFunctionDef) and field == "body")
        for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST):
                own = child if isinstance(child, ast.stmt) else statement
                yield Place(child, tree, field, place, own, inside)
                yield from places(child, own, inside)


def mutants(root: Path, rooms: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """So many random faults of some rooms' files: one a line, each line as likely as another."""
    trees = {}
    lines: dict[tuple[str, int], list[tuple[Place, str, ast.AST]]] = defaultdict(list)
    files = [
        file for room in rooms for file in ((root / room).rglob("*.py") if (root / room).is_dir() else [root / room])
    ]
    for file in files:
        path = file.relative_to(root).as_posix()
        trees[path] = tree = ast.parse(file.read_text(encoding="utf-8"))
        for place in places(tree, ast.Pass(lineno=0)):
            for words, other in faults(place.node):
                lines[path, place.node.lineno].append((place, words, other or ast.Pass()))  # type: ignore[attr-defined]
    draw, found = random.Random(seed), []
    for path, line in draw.sample(sorted(lines), min(count, len(lines))):
        place, words, other = draw.choice(lines[path, line])
        place.put(ast.copy_location(other, place.node))
        text = ast.unparse(ast.fix_missing_locations(trees[path]))
        place.put(place.node)
        last = line if isinstance(place.node, ast.stmt) else getattr(place.node, "end_lineno", line)
        run = frozenset((place.statement.lineno, *range(line, last + 1)))
        found.append(Mutant(path, line, run, place.is_imported, words, text))
    return found


class Copy:
    """A copy of a checkout's files, where tests run with this environment and a cache of its own."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        self.root, self._folder, self._changes = folder / checkout.name, folder, 0
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=checkout, capture_output=True, text=True, check=True)
        for name in filter(None, listed.stdout.split("\0")):
            if (checkout / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(checkout / name, self.root / name)
        (folder / "plugins").mkdir()
        (folder / "plugins" / "mutation_plugin.py").write_text(PLUGIN, encoding="utf-8")
        self._environment = {
            **os.environ, "PYTHONPATH": f"{self.root}{os.pathsep}{folder / 'plugins'}", "OPENBLAS_NUM_THREADS": "1",
            "VALVE_SIM_CACHE": str(folder / "cache"), "MUTATION_FOUND": str(folder / "found.json"),
        }  # fmt: skip

    def known(self, rooms: Sequence[str], tests: Sequence[str]) -> Known:
        """Run the short tests with the code that is right."""
        from coverage import CoverageData

        data = CoverageData(str(self._folder / "coverage"))
        files = ",".join(f"{self.root / room}{'/*' if (self.root / room).is_dir() else ''}" for room in rooms)
        measured = ["-m", "coverage", "run", f"--include={files}", f"--data-file={data.data_filename()}"]
        self._run(measured, ["-p", "mutation_plugin", "-m", SHORT, *tests], None)
        found = json.loads((self._folder / "found.json").read_text(encoding="utf-8"))
        data.read()
        lines = {
            self._name(path): {line: set(own) for line, own in data.contexts_by_lineno(path).items()}
            for path in data.measured_files()
        }
        sources = [(self._name(path), *span) for path, *span in found["sources"] if str(self.root) in path]
        return Known(found["seconds"], lines, sources)

    def is_killed(self, mutant: Mutant, tests: Sequence[str], limit: float) -> bool:
        """Whether a test fails, or does not end, with a fault."""
        path = self.root / mutant.path
        right = path.read_text(encoding="utf-8")
        try:
            self._write(path, mutant.text)
            return self._run([], ["-x", *tests], limit)
        finally:
            self._write(path, right)

    def _name(self, path: str) -> str:
        return Path(path).relative_to(self.root).as_posix()

    def _write(self, path: Path, text: str) -> None:
        """With a time of its own: compiled files are told apart by it."""
        self._changes += 1
        path.write_text(text, encoding="utf-8")
        os.utime(path, (1e9 + self._changes, 1e9 + self._changes))

    def _run(self, before: Sequence[str], options: Sequence[str], limit: float | None) -> bool:
        """Run pytest; whether it found a failure, or did not end in so many seconds."""
        command = [sys.executable, *before, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
        with subprocess.Popen(
            command, cwd=self.root, env=self._environment, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as process:  # fmt: skip
            try:
                return process.wait(limit) != 0
            except subprocess.TimeoutExpired:
                return True
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)


def default_tests(root: Path, room: str) -> list[str]:
    """The folder of tests that is named as the room is, and the files beside it."""
    folder = root / "test" / room.removesuffix(".py")
    beside = sorted((root / "test").glob(f"test_{folder.name}*.py"))
    return [path.relative_to(root).as_posix() for path in (folder, *beside) if path.exists()]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the command line names."""
    options = parser("mutation", __doc__)
    options.add_argument("rooms", nargs="+", help="folders or files of valve_sim, such as identification/fit")
    options.add_argument("--mutants", type=at_least_one, default=50, help="how many (default: 50)")
    options.add_argument("--seed", type=int, default=0, help="of the draw (default: 0)")
    options.add_argument("--against", type=Path, default=Path(), help="another checkout (default: the working folder)")
    options.add_argument(
        "--tests", nargs="+", help="tests, as pytest takes them (default: those named as the rooms are)"
    )
    options.add_argument("--most", type=float, default=120.0, help="CPU s of tests a mutant (default: 120)")
    asked = options.parse_args(arguments)
    checkout, rooms = asked.against.resolve(), [f"valve_sim/{room.rstrip('/')}" for room in asked.rooms]
    tests = asked.tests or [test for room in asked.rooms for test in default_tests(checkout, room)]
    if missing := [room for room in rooms if not (checkout / room).exists()]:
        options.error(f"{missing[0]}: there is no such room")
    if not tests:
        options.error(f"{asked.rooms[0]}: has no tests of its name; name some with --tests")
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        measure(Copy(checkout, Path(folder)), rooms, tests, asked)
    return 0


def measure(tree: Copy, rooms: Sequence[str], tests: Sequence[str], asked: argparse.Namespace) -> None:
    """Run all mutants of some rooms, and print each, the score and the survivors."""
    started, title = time.perf_counter(), " ".join(rooms)
    known = tree.known(rooms, tests)
    print(f"{title}: {len(known.seconds)} tests pass in {sum(known.seconds.values()):.0f} s", flush=True)
    survivors, cut = [], 0
    drawn = mutants(tree.root, rooms, asked.mutants, asked.seed)
    for mutant in drawn:
        all_tests = known.tests_of(mutant)
        ends = list(itertools.accumulate(known.seconds[test] for test in all_tests))
        chosen = [test for test, end in zip(all_tests, ends, strict=True) if end <= max(asked.most, ends[0])]
        cut += len(chosen) < len(all_tests)
        is_killed = bool(chosen) and tree.is_killed(mutant, chosen, LATEST + SLOWER * ends[len(chosen) - 1])
        how = "killed" if is_killed else f"survives {len(chosen)} tests" if chosen else "no test executes it"
        told = f"  {mutant.path}:{mutant.line}: {mutant.words}: {how}"
        print(told, flush=True)
        survivors += [] if is_killed else [told]
    print(f"{title}: {len(drawn) - len(survivors)} of {len(drawn)} killed, seed {asked.seed}, in "
          f"{time.perf_counter() - started:.0f} s; {cut} not by all of their tests (--most); survivors:")  # fmt: skip
    print("\n".join(survivors))


if __name__ == "__main__":
    raise SystemExit(main())
