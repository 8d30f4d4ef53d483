"""Size of the code against the ceilings in `pyproject.toml`; part of `make lint`.

python -m benchmarks.ceilings [--lower] [--list GROUP]

Four kinds are counted for each group of packages in `[tool.ceilings]`: code lines, classes, dataclasses that are built
at one place, and private functions that are called once. Blank lines, comments and docstrings are not code lines.
A figure above its ceiling fails. So do ceilings of a kind that add up to more than in the commit before, without the
lines that `[tool.granted]` grants to a new ability. Code that moves takes its ceiling along. `--lower` writes ceilings
down to what is counted.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[1]
KINDS: Final = ("lines", "classes", "dataclasses_built_once", "private_functions_called_once")
TEXT_SUFFIXES: Final = (".js", ".j2")
#: Most lines that a new ability is granted, in the product, and in its tests and benchmarks.
MOST_GRANTED: Final = 900
_NO_CODE: Final = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
_TEXT_COMMENT: Final = re.compile(r"/\*.*?\*/|\{#.*?#\}|^\s*//[^\n]*", re.DOTALL | re.MULTILINE)


def code_lines(text: str) -> int:
    """Number of lines of a Python file that hold code: no blank lines, comments and docstrings."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                lines.difference_update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(lines)


def text_lines(text: str) -> int:
    """Number of lines of a script or template that are neither blank nor comment."""
    return sum(bool(line.strip()) for line in _TEXT_COMMENT.sub("", text).splitlines())


def measured(paths: Iterable[Path]) -> dict[str, list[str]]:
    """Return what is counted of each kind in these files; `lines` has one entry a line."""
    trees, out = {}, {kind: [] for kind in KINDS}
    for path in paths:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".py":
            trees[path] = ast.parse(text)
            out["lines"] += [path.name] * code_lines(text)
        else:
            out["lines"] += [path.name] * text_lines(text)
    for path, tree in trees.items():
        classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        out["classes"] += [f"{path}: {node.name}" for node in classes]
        names = Counter(_names(tree))
        functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
        out["private_functions_called_once"] += [
            f"{path}: {node.name}"
            for node in functions
            if node.name.startswith("_") and not node.name.startswith("__") and names[node.name] == 1
        ]
    return out


def built_once(groups: dict[str, list[Path]]) -> dict[str, list[str]]:
    """Dataclasses of each group that all groups together build at one place."""
    places: Counter[str] = Counter()
    dataclasses: dict[str, list[str]] = {name: [] for name in groups}
    for name, paths in groups.items():
        for path in paths:
            if path.suffix != ".py":
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for node in ast.walk(tree):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    places[node.func.id] += 1
                elif isinstance(node, ast.ClassDef) and any("dataclass" in ast.unparse(d) for d in node.decorator_list):
                    dataclasses[name].append(node.name)
    return {name: [each for each in classes if places[each] == 1] for name, classes in dataclasses.items()}


def _names(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def files_of(patterns: Iterable[str], root: Path = ROOT) -> list[Path]:
    """Return the counted files of these patterns; of a folder all below it."""
    paths = [path for pattern in patterns for path in sorted(root.glob(pattern))]
    files = [file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
    return [path for path in files if path.suffix in (".py", *TEXT_SUFFIXES)]


def raised(tool: dict[str, Any], root: Path) -> list[str]:
    """Kinds whose ceilings add up to more than in the last commit or in the one before it; none without a history."""
    out = [f"{name} is granted {n} lines" for name, n in tool.get("granted", {}).items() if n > MOST_GRANTED]
    for commit in ("HEAD", "HEAD~1"):
        shown = subprocess.run(["git", "show", f"{commit}:./pyproject.toml"], cwd=root, capture_output=True, text=True)
        before = tomllib.loads(shown.stdout).get("tool", {})
        for kind in KINDS if "ceilings" in before else ():
            sums = [
                sum(entry[kind] for entry in each["ceilings"].values())
                - (sum(each.get("granted", {}).values()) if kind == "lines" else 0)
                for each in (before, tool)
            ]
            out += [f"ceilings of {kind} add up to {sums[1]}, {sums[0]} in {commit}"] if sums[1] > sums[0] else []
    return out


def main(argv: list[str], root: Path = ROOT) -> int:
    """Exit 1 when a figure is above its ceiling; `root` holds `pyproject.toml`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ceilings", description=__doc__)
    parser.add_argument("--lower", action="store_true", help="write ceilings down to what is counted")
    parser.add_argument("--list", metavar="GROUP", help="what is counted in this group")
    arguments = parser.parse_args(argv)
    file = root / "pyproject.toml"
    text = file.read_text(encoding="utf-8")
    tool = tomllib.loads(text)["tool"]
    ceilings = tool["ceilings"]
    groups = {name: files_of(entry["holds"], root) for name, entry in ceilings.items()}
    once, above = built_once(groups), []
    print(f"{'group':14s}" + "".join(f"{kind:>34s}" for kind in KINDS))
    for name, entry in ceilings.items():
        counts = measured(groups[name]) | {"dataclasses_built_once": once[name]}
        print(f"{name:14s}" + "".join(f"{f'{len(counts[kind])} of {entry[kind]}':>34s}" for kind in KINDS))
        above += [
            f"{name}: {len(counts[kind])} {kind}, ceiling {entry[kind]}"
            for kind in KINDS
            if len(counts[kind]) > entry[kind]
        ]
        if arguments.list == name:
            print("\n".join(f"  {kind}: {each}" for kind in KINDS[1:] for each in counts[kind]))
        if arguments.lower:
            for kind in KINDS:
                stated = re.compile(rf"(\[tool\.ceilings\.{name}\]\n(?:(?!\[tool).*\n)*?{kind} = )\d+")
                text = stated.sub(rf"\g<1>{min(len(counts[kind]), entry[kind])}", text)
    if arguments.lower:
        file.write_text(text, encoding="utf-8")
    above += raised(tool, root)
    for line in above:
        print(f"above its ceiling: {line}; remove code, the ceiling is not raised", file=sys.stderr)
    return 1 if above else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
