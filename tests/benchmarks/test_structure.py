"""The code has its documented structure: no circular import, no upward import, no name twice."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from benchmarks.structure import (
    LAYERS,
    ROOT,
    TORQUE_PATH,
    CodeStructure,
    circles,
    figures,
    read_structure,
    upward,
)


@pytest.fixture(scope="module")
def found() -> dict[str, dict]:
    return figures(read_structure())


@pytest.mark.slow
@pytest.mark.xdist_group("structure")
@pytest.mark.parametrize(
    "name",
    [
        "files at the root of gateway",
        "circular imports between packages",
        "circles of imports between files",
        "imports from a lower layer to a higher one",
        "packages that have no layer",
        "public class names used twice",
    ],
)
def test_repository_structure_is_as_drawn(found: dict[str, dict], name: str) -> None:
    allowed = 2 if name == "files at the root of gateway" else 0
    assert found[name]["value"] == allowed, found[name]["list"]


def test_groups_that_reach_each_other_are_circles() -> None:
    edges = [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"), ("d", "e"), ("e", "d"), ("f", "a")]
    assert circles(edges) == [["a", "b", "c"], ["d", "e"]]


def test_import_of_a_higher_layer_is_found() -> None:
    edges = frozenset({("gateway.model.robot", "gateway.report.view"), ("gateway.report.view", "gateway.model.robot")})
    assert upward(CodeStructure({}, edges, {})) == [("gateway.model.robot", "gateway.report.view")]


def test_modules_of_a_folder_are_read_with_their_imports(tmp_path: Path) -> None:
    for name, text in {
        "drives/a.py": "class Thing:\n    pass\n",
        "gateway/b.py": "def later():\n    from drives import a\n",
        "sim/c/__init__.py": "from drives.a import Thing\nclass Thing:\n    pass\nclass _Own:\n    pass\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    structure = read_structure(tmp_path)
    assert structure.imports == {("gateway.b", "drives.a"), ("sim.c", "drives.a")}
    assert structure.classes == {"Thing": ("drives.a", "sim.c")}
    assert structure.lines == {"drives.a": 2, "gateway.b": 2, "sim.c": 5}


def test_layers_are_those_of_the_linter() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(each["layers"] for each in contracts if each["type"] == "layers")
    assert [tuple(layer.split(" : ")) for layer in reversed(layers)] == list(LAYERS)


@pytest.mark.parametrize(("path", "name"), TORQUE_PATH)
def test_the_transmission_of_a_torque_is_as_drawn(path, name):
    assert name in (ROOT / path).read_text(encoding="utf-8")
