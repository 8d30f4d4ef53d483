"""No number of the diagnosis without its meaning, its unit and where it comes from."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

import gateway
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.rest_thresholds import CONFLICT, REST_MODEL
from gateway.identify.tuned_number import described

HOME = Path(gateway.__file__).parent
FILES = {
    str(path.relative_to(HOME)): path.read_text(encoding="utf-8")
    for part in ("diagnose", "identify/rest")
    for path in sorted((HOME / part).rglob("*.py"))
}
#: Numbers that count, halve or square, and those that only keep an arithmetic from overflow or from dividing by zero.
PLAIN = {0, 0.5, 1, 2, 3, 4}
GUARD = 1e-6
#: Numbers inside functions that are steps of an arithmetic or weights of a start: no more than there are today.
INSIDE = {
    "diagnose/moving/penalised_fit.py": 4,
    "diagnose/moving/moving_mistakes.py": 1,
    "diagnose/moving/moving_outcome.py": 1,
    "diagnose/moving/parameters.py": 1,
    "diagnose/moving/select.py": 8,
    "diagnose/rest/verdict.py": 3,
    "identify/rest/hypothesis_fit.py": 3,
    "identify/rest/linear.py": 6,
    "identify/rest/rest_loads.py": 3,
    "diagnose/rest/rest_outcome.py": 2,
    "identify/rest/start_noise.py": 3,
}


@pytest.mark.parametrize(
    "thresholds", [REST, MOVING, REST_MODEL, CONFLICT], ids=["at rest", "in motion", "model at rest", "conflict"]
)
def test_every_threshold_says_what_it_is_and_where_it_comes_from(thresholds):
    listed = list(described(thresholds))
    assert listed
    for name, value, unit, meaning, origin in listed:
        assert value is not None, name
        assert len(meaning.split()) >= 2, name
        assert origin.strip(), name
        assert unit == unit.strip(), name


def numbers(node: ast.AST) -> list[ast.Constant]:
    """Numeric literals below a node, True and False left out."""
    return [
        each
        for each in ast.walk(node)
        if isinstance(each, ast.Constant) and isinstance(each.value, (int, float)) and not isinstance(each.value, bool)
    ]


def unexplained(text: str) -> list[str]:
    """Names of constants of a module that hold a number and have no `#:` line above them, nor share one."""
    lines, out = text.splitlines(), []
    covered = None
    for node in ast.parse(text).body:
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or node.value is None:
            continue
        above = node.lineno - 2
        documented = above == covered or (above >= 0 and lines[above].startswith("#:"))
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        names = [each.id for each in ast.walk(target) if isinstance(each, ast.Name) and each.id.isupper()]
        if names and numbers(node.value) and not documented:
            out += names
        if documented:
            covered = (node.end_lineno or node.lineno) - 1
    return out


def test_the_scan_finds_an_unexplained_number():
    assert unexplained("LIMIT = 0.3\n") == ["LIMIT"]
    assert unexplained("#: Share [-] of something.\nLIMIT: Final = 0.3\n") == []
    assert unexplained("#: Both [kg].\nONE = 1e3\nOTHER = 1e3\nTHIRD = (2.0, 1)\n\nFOURTH = 5\n") == ["FOURTH"]
    assert unexplained("LEAST, MOST = 6, 24\n") == ["LEAST", "MOST"]
    assert unexplained("NAMES = ('a', 'b')\nlimit = 3\n") == []


@pytest.mark.parametrize("name", [name for name in FILES if not name.endswith("thresholds.py")])
def test_every_constant_of_a_module_is_explained_above_it(name):
    assert unexplained(FILES[name]) == []


def inside(text: str) -> Counter[float]:
    """Numbers in functions that neither count nor guard."""
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    found = {(each.lineno, each.col_offset): float(each.value) for node in functions for each in numbers(node)}
    return Counter(value for value in found.values() if abs(value) not in PLAIN and abs(value) > GUARD)


@pytest.mark.parametrize("name", [name for name in FILES if not name.endswith("thresholds.py")])
def test_no_tuned_number_hides_in_a_function(name):
    assert sum(inside(FILES[name]).values()) <= INSIDE.get(name, 0), inside(FILES[name])
