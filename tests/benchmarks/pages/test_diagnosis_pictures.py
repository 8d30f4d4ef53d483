"""Reports with a formula and with a pair that further poses decided; `--pictures` puts parts of them into the docs."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gateway.report.render import render
from gateway.result.result import Result
from tests.support.pages.browser import MISSING, Browser, available
from tests.support.pages.diagnosed import decided, with_formula
from tests.support.pages.faults import show_whole

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not available(), reason=MISSING)]
#: Part of a page from the first element that holds a text to the next heading.
PART = """const y = e => e.getBoundingClientRect().top + scrollY;
const found = [...document.querySelectorAll('h2, p')].find(e => e.textContent.includes(WANTED));
const top = y(found.tagName == 'P' ? found.parentElement : found) - 10;
const next = [...document.querySelectorAll('h2')].map(y).find(each => each > top + 100);
return {x: 0, y: top, width: innerWidth, height: Math.min(next - top - 10, 770)};"""


def opened(window: Browser, result: Result, file: Path) -> str:
    """Text of the report of a result, which has no faults, as wide as a screen."""
    show_whole(window, render(result), file)
    return window.run("return document.body.innerText")


def taken(window: Browser, text: str, file: Path) -> None:
    window.picture(file, window.run(PART.replace("WANTED", repr(text))))
    assert file.stat().st_size > 10_000


def test_a_report_shows_a_formula_with_its_test_on_other_poses(window: Browser, tmp_path: Path, pictures: Path) -> None:
    result = with_formula()
    text = opened(window, result, tmp_path / "formula.html")
    assert result.formula is not None
    found = {piece.expression: piece.coefficient for piece in result.formula.pieces}
    assert found["sin(2*q2 + 2*q3)"] == pytest.approx(120.0 * math.cos(0.4), rel=0.1)
    assert found["cos(2*q2 + 2*q3)"] == pytest.approx(120.0 * math.sin(0.4), rel=0.1)
    assert all(expression in text for expression in found)
    taken(window, "Candidate formula", pictures / "formula.png")


def test_a_report_says_what_was_open_until_further_poses_were_measured(
    window: Browser, tmp_path: Path, pictures: Path
) -> None:
    result = decided()
    text = opened(window, result, tmp_path / "decided.html")
    assert [(effect.name, effect.joints) for effect in result.effects] == [("cable_torque", (5,))]
    assert result.decided is not None
    assert {effect.name for effect in result.decided.effects} == {"cable_torque", "torque_offset"}
    assert f"It took {result.decided.poses} further poses" in text
    taken(window, "further poses", pictures / "decided.png")
