"""Mutants: what is changed is one thing, and a test that looks at it notices."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutants import Mutant, noticed

LARGER = "def larger(a, b):\n    if a > b:\n        return a\n    return b\n"
LOOKS = "from drives.a import larger\n\ndef test_larger():\n    assert larger(1, 2) == 2\n"


@pytest.fixture
def project(tmp_path) -> Path:
    for name, text in {
        "drives/__init__.py": "",
        "drives/a.py": LARGER,
        "gateway/__init__.py": "",
        "tests/drives/test_a.py": LOOKS,
        "tests/drives/test_b.py": "def test_nothing():\n    pass\n",
        "pyproject.toml": '[tool.pytest.ini_options]\npythonpath = ["."]\n',
    }.items():
        Path(tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


MUTANT = Mutant("drives/a.py", 2, 0, "Gt to LtE")


@pytest.mark.slow
@pytest.mark.parametrize(
    "first", [(), ("tests/drives/test_a.py::test_larger",), ("tests/drives/test_b.py::test_nothing",)]
)
def test_a_test_that_looks_notices_whichever_is_asked_first(project, first):
    assert noticed(MUTANT, project, first) == "fast"
    assert (project / "drives/a.py").read_text() == LARGER


@pytest.mark.slow
@pytest.mark.parametrize(
    "first", [(), ("tests/drives/test_a.py::test_larger",), ("tests/drives/test_a.py::test_gone",)]
)
def test_a_test_that_does_not_look_does_not_notice(project, first):
    (project / "tests/drives/test_a.py").write_text(LOOKS.replace("== 2", "in (1, 2)"))
    assert not noticed(MUTANT, project, first)
