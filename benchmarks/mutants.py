"""Do the tests notice? One operator flipped, one `not` or one `raise` dropped at a time, then the mirrored tests.

python -m benchmarks.mutants [--count 200] [--seed 1] [--jobs 2] [--packages drives,gateway/motion] [--out out/mutants]

Mutants are drawn at random over all places of the packages, each is tried in a copy of the project. The mirrored tests
of the fast suite run once as they are, and have to pass. Then the tests that cover the changed lines run first, then
the others, then the slow suite. What no test notices is listed with its place.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Final

from coverage import CoverageData

from benchmarks.figure import figure

ROOT: Final = Path(__file__).resolve().parents[1]
#: Packages with the share of mutants that has to be detected.
PACKAGES: Final = {
    "drives": 95.0,
    "gateway/motion": 95.0,
    "gateway/model": 85.0,
    "gateway/identify": 85.0,
    "gateway/estimate": 85.0,
    "gateway/diagnose": 85.0,
    "gateway/pair": 85.0,
}
#: A mutant with which the tests run longer than this has been noticed [s]: all together, and one of them, of which the
#: slowest takes a tenth.
LONGEST_S: Final = 900.0
_ARGUMENTS: Final = ("-x", "-q", "-p", "no:cacheprovider", "--timeout=100")
#: What pytest is given for each suite, in the order in which they are asked.
SUITES: Final = {"fast": ("-m", "not slow"), "slow": ("-m", "slow")}
#: Exit codes of pytest: a test failed, or none could be collected; others may come from what it was asked for.
_FAILED, _BROKEN, _NONE_LEFT = 1, 2, 5
COPIED: Final = ("drives", "gateway", "sim", "tests", "benchmarks", "examples", "docs", "pyproject.toml", "README.md")
COMPARED: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
COMPUTED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    path, line : where
    number : which of the file's places, in the order of the tree
    what : change in words
    """

    path: str
    line: int
    number: int
    what: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.what}"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a file can be changed, and how."""

    line: int
    what: str
    change: Callable[[], None]


def places(tree: ast.Module) -> Iterator[Place]:
    """Every place of a module at which a mutant can be made; annotations and the words of messages are left alone."""
    quiet = {id(inner) for node in ast.walk(tree) for inner in _left_alone(node)}
    for node in ast.walk(tree):
        if id(node) not in quiet:
            yield from _places_at(node)


def _left_alone(node: ast.AST) -> Iterator[ast.AST]:
    """Annotations and texts of errors: a wrong word there changes no behaviour."""
    for name in ("annotation", "returns"):
        part = getattr(node, name, None)
        if isinstance(part, ast.AST):
            yield from ast.walk(part)
    if isinstance(node, ast.Raise) and node.exc is not None:
        yield from ast.walk(node.exc)


def _places_at(node: ast.AST) -> Iterator[Place]:
    if isinstance(node, ast.Compare):
        for number, operator in enumerate(node.ops):
            other = COMPARED.get(type(operator))
            if other is not None:
                yield Place(node.lineno, _words(operator, other), _set(node.ops, number, other()))
    elif isinstance(node, ast.BinOp) and type(node.op) in COMPUTED and not _joins_types(node):
        other = COMPUTED[type(node.op)]
        yield Place(node.lineno, _words(node.op, other), lambda: setattr(node, "op", other()))
    elif isinstance(node, ast.BoolOp):
        swapped = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield Place(node.lineno, _words(node.op, swapped), lambda: setattr(node, "op", swapped()))
    for name, value in ast.iter_fields(node):
        if isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.Not):
            yield Place(value.lineno, "not dropped", _put(node, name, value.operand))
        if isinstance(value, list):
            for number, item in enumerate(value):
                if isinstance(item, ast.Raise):
                    yield Place(item.lineno, "raise dropped", _set(value, number, ast.Pass()))
                elif isinstance(item, ast.UnaryOp) and isinstance(item.op, ast.Not):
                    yield Place(item.lineno, "not dropped", _set(value, number, item.operand))


def _joins_types(node: ast.BinOp) -> bool:
    """`A | None` at the level of a module or in a call such as `isinstance` is a type, not a computation."""
    return isinstance(node.op, ast.BitOr) and any(
        isinstance(side, ast.Constant) and side.value is None for side in (node.left, node.right)
    )


def _words(before: ast.AST, after: type[ast.AST]) -> str:
    return f"{type(before).__name__} to {after.__name__}"


def _set(items: list, number: int, new: ast.AST) -> Callable[[], None]:
    def change() -> None:
        items[number] = new

    return change


def _put(node: ast.AST, name: str, new: ast.AST) -> Callable[[], None]:
    return lambda: setattr(node, name, new)


def mutated(text: str, number: int) -> str:
    """The text of a module with its place of that number changed."""
    tree = ast.parse(text)
    list(places(tree))[number].change()
    return ast.unparse(ast.fix_missing_locations(tree))


def draw(count: int, seed: int, packages: Sequence[str], root: Path = ROOT) -> list[Mutant]:
    """Draw mutants of each package in proportion to its places; at least one a package."""
    every: dict[str, list[Mutant]] = {}
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            name = str(path.relative_to(root))
            found = enumerate(places(ast.parse(path.read_text())))
            every.setdefault(package, []).extend(
                Mutant(name, place.line, number, place.what) for number, place in found
            )
    total = sum(map(len, every.values()))
    chosen: list[Mutant] = []
    for package, mutants in every.items():
        share = max(1, round(count * len(mutants) / total))
        chosen += random.Random(f"{package} {seed}").sample(mutants, min(share, len(mutants)))
    return chosen


def mirrored(path: str) -> str:
    """Folder of the tests that mirror the package of a module."""
    parts = Path(path).parts
    return str(Path("tests", *parts[:2]) if parts[0] == "gateway" else Path("tests", parts[0]))


class Reach:
    """Which tests come to which lines.

    Parameters
    ----------
    folders : sequence of str
        Of tests; they are run once as the project is.
    copy : Path
        The project.

    Raises
    ------
    SystemExit
        A test fails already.
    """

    def __init__(self, folders: Sequence[str], copy: Path) -> None:
        self._root = copy
        path = copy / ".reach"
        measured = (*SUITES["fast"], "--cov=drives", "--cov=gateway", "--cov-context=test", "--cov-report=", *folders)
        if _pytest(copy, *measured, COVERAGE_FILE=str(path)) != 0:
            raise SystemExit(f"a test of {', '.join(folders)} fails before anything is changed")
        self._data = CoverageData(str(path))
        self._data.read()
        #: How many lines each test comes to.
        self._lines = Counter(
            name.rpartition("|")[0]
            for file in self._data.measured_files()
            for names in self._data.contexts_by_lineno(file).values()
            for name in names
        )

    def tests(self, mutant: Mutant) -> tuple[str, ...]:
        """Tests that come to the statement of a mutant, those that come to little else first."""
        path = self._root / mutant.path
        first, last = _statement(path.read_text(), mutant.line)
        contexts = self._data.contexts_by_lineno(str(path))
        found = {each.rpartition("|")[0] for line in range(first, last + 1) for each in contexts.get(line, ())}
        here = {name for name in found if name.startswith(f"{mirrored(mutant.path)}/")}
        return tuple(sorted(here, key=lambda name: (self._lines[name], name)))


def _statement(text: str, line: int) -> tuple[int, int]:
    """First and last line of the smallest statement at a line; of one with a body, the head."""
    spans = [(1, 0)]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            spans.append(
                (node.lineno, max(node.lineno, body[0].lineno - 1) if body else node.end_lineno or node.lineno)
            )
    around = [(first, last) for first, last in spans if first <= line <= last]
    return min(around, key=lambda span: span[1] - span[0], default=(line, line))


def _pytest(copy: Path, *arguments: str, **environment: str) -> int:
    """Exit code of the tests; the copy is what every process of a test imports."""
    command = [sys.executable, "-m", "pytest", *_ARGUMENTS, *arguments]
    around = {**os.environ, "PYTHONPATH": str(copy), **environment}
    try:
        return subprocess.run(
            command, cwd=copy, env=around, capture_output=True, timeout=LONGEST_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return _FAILED


def noticed(mutant: Mutant, copy: Path, first: Sequence[str] = ()) -> str:
    """Suite of which a mirrored test fails with the mutant in a copy of the project, "" if none does.

    The fast suite is asked first, and in it the tests of `first`.
    """
    path = copy / mutant.path
    text = path.read_text()
    path.write_text(mutated(text, mutant.number))
    try:
        if first and _pytest(copy, *first) in (_FAILED, _BROKEN):
            return "fast"
        others = [f"--deselect={name}" for name in first]
        for suite, chosen in SUITES.items():
            if _pytest(copy, mirrored(mutant.path), *chosen, *others) not in (0, _NONE_LEFT):
                return suite
        return ""
    finally:
        path.write_text(text)


def tried(mutants: Sequence[Mutant], jobs: int) -> list[str]:
    """Suite that notices each, "" for none; so many copies of the project at a time."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        free: SimpleQueue[Path] = SimpleQueue()
        for number in range(jobs):
            copy = Path(folder) / str(number)
            copy.mkdir()
            for name in COPIED:
                source = ROOT / name
                if source.is_dir():
                    shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
                else:
                    shutil.copy(source, copy / name)
            free.put(copy)
        reach = Reach(sorted({mirrored(mutant.path) for mutant in mutants}), copy)
        first = [reach.tests(mutant) for mutant in mutants]

        def one(mutant: Mutant, tests: Sequence[str]) -> str:
            copy = free.get()
            try:
                seen = noticed(mutant, copy, tests)
                print(f"{f'noticed by the {seen} suite' if seen else 'not noticed'}: {mutant}", flush=True)
                return seen
            finally:
                free.put(copy)

        with ThreadPoolExecutor(jobs) as pool:
            return list(pool.map(one, mutants, first))


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--packages", default=",".join(PACKAGES))
    parser.add_argument("--out", type=Path, default=Path("out/mutants"))
    arguments = parser.parse_args(argv)
    mutants = draw(arguments.count, arguments.seed, arguments.packages.split(","))
    seen = tried(mutants, arguments.jobs)
    figures: dict[str, dict] = {}
    for package in arguments.packages.split(","):
        here = [ok for mutant, ok in zip(mutants, seen, strict=True) if mutant.path.startswith(f"{package}/")]
        figures[f"noticed in {package}"] = figure(
            100.0 * sum(map(bool, here)) / len(here), f">= {PACKAGES.get(package, 85.0):g}", f"% of {len(here)}"
        )
    suites = [suite for suite in seen if suite]
    figures["of these by the fast suite"] = figure(
        100.0 * suites.count("fast") / max(1, len(suites)), ">= 95", f"% of {len(suites)}"
    )
    unseen = [asdict(mutant) for mutant, ok in zip(mutants, seen, strict=True) if not ok]
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "summary.json").write_text(json.dumps({"figures": figures, "unseen": unseen}, indent=1) + "\n")
    for name, found in figures.items():
        print(f"{name}: {found['value']:.0f} {found['unit']}, goal {found['goal']}")
    return 0 if all(found["met"] for found in figures.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
