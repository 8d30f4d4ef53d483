"""plan --moving: what it prints and writes, and what it refuses in words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gateway.cell.config import load_cell
from gateway.cli import main
from gateway.excite import random_series, series_choice
from gateway.excite.plan_file import read_plan

EXAMPLE = Path(__file__).parents[3] / "examples" / "small" / "cell.toml"


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few random motions and steps: enough for what is printed."""
    monkeypatch.setattr(random_series, "RANDOM", 8)
    for name in ("TRIES", "FIRST_STEPS", "MORE_STEPS"):
        monkeypatch.setattr(series_choice, name, 1)


def plan_moving(*words: str) -> Result:
    return CliRunner().invoke(main, ["plan", str(EXAMPLE), *words], env={"COLUMNS": "200"})


def test_a_plan_is_printed_written_and_drawn(tmp_path: Path) -> None:
    file, page = tmp_path / "plan.json", tmp_path / "plan.html"
    result = plan_moving("--moving", "--periods", "2", "-o", str(file), "--view", str(page))
    assert result.exit_code == 0, result.output
    for words in ("20 s of motion", "use of the limits", "best of 100 random", "Ixx", "kept apart"):
        assert words in result.output
    plan = read_plan(file, load_cell(EXAMPLE).cell.arm[0])
    assert [(each.kind, each.periods, each.period_s) for each in plan.excitations] == [("series", 2, 10.0)]
    assert json.loads(file.read_text())["expected"]["duration_s"] == 20.0
    drawn = page.read_text()
    assert "Over one period" in drawn
    assert drawn.count("speed [% of limit]</text>") == 6


def test_friction_is_asked_for_by_sweeps(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    result = plan_moving("--moving", "--for", "friction", "-o", str(file))
    assert result.exit_code == 0, result.output
    assert "friction J6" in result.output
    assert "dry friction [Nm]" in result.output
    assert {each.kind for each in read_plan(file, load_cell(EXAMPLE).cell.arm[0]).excitations} == {"sweep"}


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--for", "load"], 2, "need --moving"),
        (["--moving", "--poses", "4"], 2, "rest poses"),
        (["--moving", "--for", "load,luck"], 2, "'luck'"),
        (["--moving", "--period", "1"], 5, "too little travel"),
        (["--moving", "--period", "nan"], 5, "5 to 20 s"),
        (["--moving", "--periods", "1"], 5, "2 to 100"),
    ],
)
def test_what_makes_no_plan_is_refused(words: list[str], code: int, said: str) -> None:
    result = plan_moving(*words)
    assert result.exit_code == code
    assert said in " ".join(result.output.replace("│", " ").split())
