"""Do the tests notice? One operator flipped, one `not` or one `raise` dropped at a time, then the mirrored tests.

python -m benchmarks.mutants [--count 200] [--seed 1] [--jobs 2] [--packages drives,gateway/motion] [--out out/mutants]

Mutants are drawn at random over all places of the packages, each is tried in a copy of the project. The mirrored tests
of the fast suite run once as they are, and have to pass. Then the tests that cover the changed lines run first, then
the others, then the slow suite. What no test notices is listed with its place.
"""

from __future__ import annotations

import ast
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
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Final

from coverage import CoverageData
from coverage.parser import PythonParser

from benchmarks.figure import conclude, figure
from benchmarks.program import options

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
#: Exit codes of pytest.
_FAILED, _NO_SUCH_TEST, _NONE_LEFT = 1, 4, 5
COPIED: Final = ("drives", "gateway", "sim", "tests", "benchmarks", "examples", "docs", "pyproject.toml", "README.md")
SWAPPED: Final[dict[type[ast.AST], type[ast.AST]]] = {
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
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
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


def places(tree: ast.Module) -> Iterator[tuple[int, str, Callable[[], None]]]:
    """Yield line, words and change of every place of a module that can be mutated.

    Annotations, types joined with None and the words of messages are left alone.
    """
    quiet = {id(inner) for node in ast.walk(tree) for part in _left_alone(node) for inner in ast.walk(part)}
    for node in ast.walk(tree):
        for name, value in ast.iter_fields(node) if id(node) not in quiet else ():
            for number, item in enumerate(value if isinstance(value, list) else [value]):
                if isinstance(item, ast.Raise):
                    words, new = "raise dropped", ast.Pass()
                elif isinstance(item, ast.UnaryOp) and isinstance(item.op, ast.Not):
                    words, new = "not dropped", item.operand
                elif type(item) in SWAPPED:
                    new = SWAPPED[type(item)]()
                    words = f"{type(item).__name__} to {type(new).__name__}"
                else:
                    continue
                parts = [*value[:number], new, *value[number + 1 :]] if isinstance(value, list) else new
                yield getattr(item, "lineno", None) or node.lineno, words, partial(setattr, node, name, parts)


def _left_alone(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a node in which a change alters no behaviour."""
    match node:
        case ast.Raise(exc=ast.AST() as words):
            yield words
        case ast.BinOp(op=ast.BitOr(), left=ast.Constant(None)) | ast.BinOp(op=ast.BitOr(), right=ast.Constant(None)):
            yield node
        case _:
            parts = (getattr(node, name, None) for name in ("annotation", "returns"))
            yield from (part for part in parts if isinstance(part, ast.AST))


def mutated(text: str, number: int) -> str:
    """The text of a module with its place of that number changed."""
    tree = ast.parse(text)
    _line, _words, change = list(places(tree))[number]
    change()
    return ast.unparse(ast.fix_missing_locations(tree))


def draw(count: int, seed: int, packages: Sequence[str], root: Path = ROOT) -> list[Mutant]:
    """Draw mutants of each package in proportion to its places; at least one a package."""
    every = {
        package: [
            Mutant(str(path.relative_to(root)), line, number, words)
            for path in sorted((root / package).rglob("*.py"))
            for number, (line, words, _) in enumerate(places(ast.parse(path.read_text())))
        ]
        for package in packages
    }
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


def covering(mutants: Sequence[Mutant], copy: Path) -> list[tuple[str, ...]]:
    """Return for each mutant the mirrored tests of the fast suite that come to its statement, the most special first.

    Raises
    ------
    SystemExit
        A test fails already.
    """
    folders, path = sorted({mirrored(mutant.path) for mutant in mutants}), copy / ".reach"
    measured = (*SUITES["fast"], "--cov=drives", "--cov=gateway", "--cov-context=test", "--cov-report=", *folders)
    if _pytest(copy, *measured, COVERAGE_FILE=str(path)) != 0:
        raise SystemExit(f"a test of {', '.join(folders)} fails before anything is changed")
    data = CoverageData(str(path))
    data.read()
    contexts = {
        file: {
            line: {name.rpartition("|")[0] for name in names} for line, names in data.contexts_by_lineno(file).items()
        }
        for file in data.measured_files()
    }
    reached = Counter(name for lines in contexts.values() for names in lines.values() for name in names)
    out = []
    for mutant in mutants:
        parser = PythonParser(text=(copy / mutant.path).read_text())
        parser.parse_source()
        names = contexts.get(str(copy / mutant.path), {}).get(parser.first_line(mutant.line), set())
        here = [name for name in names if name.startswith(f"{mirrored(mutant.path)}/")]
        out.append(tuple(sorted(here, key=lambda name: (reached[name], name))))
    return out


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
        if first and _pytest(copy, *first) not in (0, _NO_SUCH_TEST, _NONE_LEFT):
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
        first = covering(mutants, copy)

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


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/mutants", jobs=2)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--packages", default=",".join(PACKAGES))
    arguments = parser.parse_args()
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
    return conclude(figures, arguments.out, unseen=unseen)


if __name__ == "__main__":
    raise SystemExit(main())
