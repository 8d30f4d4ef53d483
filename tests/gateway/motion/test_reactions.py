"""The table of reactions: complete, and printed where the engineer reads it."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from drives.errors import DriveError
from gateway.motion import reactions
from gateway.motion.reactions import MEANING, REACTIONS, markdown

SAFETY = (Path(__file__).parents[3] / "docs" / "safety.md").read_text(encoding="utf-8")


def test_the_safety_page_prints_the_table_that_the_code_goes_by() -> None:
    assert markdown() in SAFETY


@pytest.mark.parametrize("name", list(REACTIONS))
def test_every_rule_says_what_how_much_and_what_to_do(name: str) -> None:
    rule = REACTIONS[name]
    assert rule.reaction in MEANING
    assert rule.limit > 0
    assert rule.unit
    assert rule.advice or rule.reaction != "stop"
    if rule.error is not None:
        raised = rule.raised("something", node=3, more="and more")
        assert isinstance(raised, DriveError)
        assert raised.node == 3
        assert str(raised).endswith("and more")


def test_every_fault_that_is_not_fit_is_a_kind_of_the_simulator() -> None:
    from sim.faults import KINDS

    table = SAFETY.split("\n## Not yet fit for a real robot\n")[1].split("\n## ")[0]
    named = {word for line in table.splitlines() for word in line.split("|")[1:2] for word in word.split("`")[1::2]}
    assert named
    known = {kind for name in named for kind in KINDS if kind == name or kind.startswith(name.rstrip("*"))}
    assert {name for name in named if not any(k == name or k.startswith(name.rstrip("*")) for k in known)} == set()
    assert f"({len(KINDS)} kinds)" in SAFETY


def test_the_table_is_printed_only_when_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(reactions.__file__)
    assert capsys.readouterr().out == ""
    runpy.run_path(reactions.__file__, run_name="__main__")
    assert capsys.readouterr().out == markdown() + "\n"


def test_each_rule_is_in_the_table_once_with_its_reaction() -> None:
    rows = [row.split(" | ") for row in markdown().splitlines()[2:]]
    assert len(rows) == len(REACTIONS)
    found = {row[0].removeprefix("| "): row[2].removesuffix(" |") for row in rows}
    assert found == {rule.what: rule.reaction for rule in REACTIONS.values()}
