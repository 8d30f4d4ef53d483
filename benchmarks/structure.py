"""Structure of the code: files, lines, circular imports, imports from a lower layer to a higher one, repeated names.

python -m benchmarks.structure [--out out/structure] [--list]
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = ("drives", "gateway", "sim")
#: Layers of the gateway, the lowest first.
LAYERS: Final = (
    ("errors",),
    ("cell",),
    ("data",),
    ("model",),
    ("result",),
    ("identify",),
    ("estimate",),
    ("diagnose",),
    ("feedforward",),
    ("report", "formats"),
    ("pipeline",),
    ("preflight",),
    ("motion",),
    ("excite",),
    ("acquire",),
    ("check",),
    ("follow", "pair", "newcell", "live", "fleet", "drivetest", "cost"),
    ("api",),
    ("commands",),
    ("cli",),
)


#: Files that a torque passes from the frame with 0x6077 to the mass in the report, and what it is called there.
TORQUE_PATH: Final = (
    ("drives/exchange.py", "frames"),
    ("drives/decode.py", "torque_nm"),
    ("drives/values.py", "torque_nm"),
    ("drives/epoch.py", "readings"),
    ("gateway/motion/arm.py", "torque_nm"),
    ("gateway/data/sample.py", "joint_torque_nm"),
    ("gateway/acquire/rest_run.py", "samples"),
    ("gateway/data/visit.py", "motor_torque_nm"),
    ("gateway/data/recording/writer.py", "motor_torque_nm"),
    ("gateway/data/recording/samples.py", "motor_torque_nm"),
    ("gateway/data/recording/recorded.py", "motor_torque_nm"),
    ("gateway/cell/conversion.py", "joint_torque"),
    ("gateway/data/rows.py", "tau_nm"),
    ("gateway/model/visits.py", "tau_nm"),
    ("gateway/identify/rest/problem.py", "target"),
    ("gateway/identify/rest/hypothesis_fit.py", "target"),
    ("gateway/identify/solve.py", "target"),
    ("gateway/identify/rest/rest_loads.py", "moment"),
    ("gateway/identify/load_estimate.py", "mass_kg"),
    ("gateway/result/result.py", "mass_kg"),
    ("gateway/report/view.py", "mass"),
)


@dataclass(frozen=True, slots=True)
class CodeStructure:
    """What was read.

    Attributes
    ----------
    lines : of every module, by its dotted name
    imports : (module, module that it imports)
    classes : modules in which each public class is defined
    """

    lines: Mapping[str, int]
    imports: frozenset[tuple[str, str]]
    classes: Mapping[str, tuple[str, ...]]


def read_structure(root: Path = ROOT) -> CodeStructure:
    """Read all modules below `root`; imports inside functions and those for type checkers alone count too."""
    files = {_module(path.relative_to(root)): path for name in PACKAGES for path in sorted((root / name).rglob("*.py"))}
    lines, imports, classes = {}, set(), defaultdict(list)
    for module, path in files.items():
        text = path.read_text()
        tree = ast.parse(text)
        lines[module] = text.count("\n")
        imports |= {(module, other) for other in _imported(tree, files) if other != module}
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                classes[node.name].append(module)
    return CodeStructure(lines, frozenset(imports), {name: tuple(where) for name, where in classes.items()})


def _module(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imported(tree: ast.Module, files: Mapping[str, Path]) -> Iterable[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in files)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                imported = f"{node.module}.{alias.name}"
                if imported in files or node.module in files:
                    yield imported if imported in files else node.module


def layer_of(module: str) -> str:
    """Return the folder of `gateway` or the package of a module; a file of `gateway`'s root is its own package."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "gateway" else parts[0]


def circles(edges: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Groups of nodes that reach each other, largest first (Tarjan's strongly connected components)."""
    after: dict[str, set[str]] = defaultdict(set)
    for start, end in edges:
        after[start].add(end)
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(after[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(after):
        if node not in index:
            visit(node)
    return sorted(found, key=len, reverse=True)


def upward(structure: CodeStructure) -> list[tuple[str, str]]:
    """Return imports of a module of a higher layer by one of a lower layer; packages outside `LAYERS` are left out."""
    floor = {f"gateway.{name}": number for number, names in enumerate(LAYERS) for name in names}
    return sorted(
        (start, end)
        for start, end in structure.imports
        if layer_of(start) in floor and layer_of(end) in floor and floor[layer_of(start)] < floor[layer_of(end)]
    )


def figures(structure: CodeStructure) -> dict[str, dict]:
    """Numbers, each with what it counts."""
    layers = {(layer_of(start), layer_of(end)) for start, end in structure.imports if layer_of(start) != layer_of(end)}
    named = {f"gateway.{name}" for names in LAYERS for name in names} | {"drives", "gateway", "sim"}
    bare = sorted({layer_of(module) for module in structure.lines} - named)
    at_root = [
        name for name in structure.lines if layer_of(name) == name and name.startswith("gateway.") and _is_file(name)
    ]
    found: dict[str, dict] = {}
    for package in PACKAGES:
        here = [lines for module, lines in structure.lines.items() if module.split(".")[0] == package]
        found[f"{package}: files"] = {"value": len(here)}
        found[f"{package}: lines"] = {"value": sum(here)}
    repeated = {name: where for name, where in structure.classes.items() if len(where) > 1}
    return found | {
        "files at the root of gateway": {"value": len(at_root), "goal": "<= 2", "list": at_root},
        "circular imports between packages": {"value": len(circles(layers)), "goal": "== 0", "list": circles(layers)},
        "circles of imports between files": {
            "value": len(circles(structure.imports)),
            "goal": "== 0",
            "list": circles(structure.imports),
        },
        "imports from a lower layer to a higher one": {
            "value": len(upward(structure)),
            "goal": "<= 2",
            "list": [f"{start} -> {end}" for start, end in upward(structure)],
        },
        "files that a torque passes to become a mass": {
            "value": len(TORQUE_PATH),
            "goal": "<= 20",
            "list": [f"{path}: {name}" for path, name in TORQUE_PATH],
        },
        "packages that have no layer": {"value": len(bare), "list": bare},
        "public class names used twice": {
            "value": len(repeated),
            "goal": "== 0",
            "list": [f"{name}: {', '.join(where)}" for name, where in sorted(repeated.items())],
        },
    }


def _is_file(module: str) -> bool:
    return (ROOT / Path(*module.split("."))).with_suffix(".py").exists()


def main(argv: list[str]) -> int:
    """Print the figures; with ``--list`` also what they count."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.structure", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/structure"))
    parser.add_argument("--list", action="store_true", help="also what is counted")
    arguments = parser.parse_args(argv)
    found = figures(read_structure())
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "summary.json").write_text(json.dumps({"figures": found}, indent=1) + "\n")
    for name, figure in found.items():
        print(f"{name:44s} {figure['value']:6d}  {figure.get('goal', '')}")
        if arguments.list:
            for line in figure.get("list", ()):
                print("    " + (line if isinstance(line, str) else ", ".join(line)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
