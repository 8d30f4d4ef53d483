"""Ceilings of code size: what counts as code, and that a figure above its ceiling fails."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from benchmarks.ceilings import code_lines, main, text_lines

MODULE = '''"""Docstring
of two lines."""

# a comment
from dataclasses import dataclass

TEXT = """two
lines"""  # of code


@dataclass
class Built:
    """Docstring."""

    value: int


def _helper() -> Built:
    """Docstring."""
    return Built(1)


def offered() -> int:
    return _helper().value
'''
PROJECT = """[tool.ceilings.all]
holds = ["product"]
lines = {lines}
classes = 1
dataclasses_built_once = {dataclasses}
private_functions_called_once = {functions}
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "product").mkdir()
    (tmp_path / "product/module.py").write_text(MODULE)
    return tmp_path


def stated(project: Path, lines: int, dataclasses: int = 1, functions: int = 1) -> None:
    text = PROJECT.format(lines=lines, dataclasses=dataclasses, functions=functions)
    (project / "pyproject.toml").write_text(text)


def test_blank_lines_comments_and_docstrings_are_no_code() -> None:
    assert code_lines(MODULE) == 10
    assert text_lines("// comment\nlet a = 1;\n\n/* more\nlines */\n{# of a template #}\n{% if a %}\n") == 2


def test_what_is_at_its_ceiling_passes(project: Path) -> None:
    stated(project, lines=10)
    assert main([], project) == 0


@pytest.mark.parametrize("ceiling", [{"lines": 9}, {"lines": 10, "dataclasses": 0}, {"lines": 10, "functions": 0}])
def test_what_is_above_its_ceiling_fails(
    project: Path, ceiling: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    stated(project, **ceiling)
    assert main([], project) == 1
    assert "above its ceiling: all" in capsys.readouterr().err


def test_ceilings_are_lowered_and_never_raised(project: Path) -> None:
    stated(project, lines=50, functions=0)
    assert main(["--lower"], project) == 1
    text = (project / "pyproject.toml").read_text()
    assert "lines = 10\n" in text
    assert "private_functions_called_once = 0\n" in text


def test_a_commit_that_raises_a_ceiling_fails(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for lines in (10, 12):
        stated(project, lines)
        for words in (["init", "-q"], ["add", "."], ["-c", "user.name=a", "-c", "user.email=a", "commit", "-qm", "a"]):
            subprocess.run(["git", *words], cwd=project, check=True)
    assert main([], project) == 1
    assert "ceilings of lines add up to 12, 10 in HEAD~1" in capsys.readouterr().err
    file = project / "pyproject.toml"
    text = file.read_text()
    for granted, expected in ((2, 0), (901, 1)):
        file.write_text(f"{text}\n[tool.granted]\nnew = {granted}\n")
        assert main([], project) == expected
