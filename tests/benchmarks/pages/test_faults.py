"""What overlaps or is cut off is found, in a browser: on pages that are broken on purpose, and on none that is not."""

from __future__ import annotations

import pytest

from tests.support.pages.browser import MISSING, available
from tests.support.pages.faults import FAULTS, faults_of
from tests.support.pages.samples import PAGES

pytestmark = pytest.mark.skipif(not available(), reason=MISSING)
BOX = "position:absolute;top:50px"
LONG = "a" * 90


@pytest.mark.parametrize(
    ("body", "kinds"),
    [
        ("<p>plain</p><p>text</p>", set()),
        ("<p style='width:200px'>some <b>bold</b> words that go on for several lines, and on</p>", set()),
        (f"<p style='{BOX};left:5px'>one text</p><p style='{BOX};left:20px'>another</p>", {"overlap"}),
        (f"<p>{LONG}</p>", {"cut off"}),
        (f"<div style='overflow:hidden;width:90px'><span>{LONG}</span></div>", {"cut off"}),
        (f"<div style='overflow-x:auto;width:90px'><span>{LONG}</span></div>", {"cut off"}),
        ("<svg width=100 height=40><text x=5 y=20>number</text><text x=12 y=20>label</text></svg>", {"overlap"}),
        ("<svg width=100 height=40 style='overflow:visible'><text x=600 y=20>far</text></svg>", {"cut off"}),
        ("<h2>one</h2><table style='margin-top:-30px'><tr><td>&nbsp;</td></tr></table>", {"overlap"}),
    ],
)
def test_what_is_broken_is_found_and_nothing_else(window, tmp_path, body, kinds):
    file = tmp_path / "page.html"
    file.write_text(f"<!DOCTYPE html><body>{body}</body>", encoding="utf-8")
    window.resize(390, 600)
    window.open(file)
    assert {fault["kind"] for fault in window.run(FAULTS)} == kinds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "texts"),
    [
        ("result", ()),
        ("report", ()),
        ("pair", ()),
        ("stop", ()),
        ("formula", ("sin(2*q2 + 2*q3)", "cos(2*q2 + 2*q3)")),
        ("decided", ("It took 8 further poses",)),
        ("fleet", ("drift of the gain [% a year]", "visit", "not seen", "cannot tell", "healthy")),
        ("fleet-robot", ("J6 friction [Nm]", "J6 Coulomb [Nm]", "J6 viscous [Nm s/rad]", "weld mass [kg]")),
    ],
)
def test_a_page_is_whole_on_every_screen_and_on_paper(window, tmp_path, name, texts):
    file = tmp_path / f"{name}.html"
    file.write_text(PAGES[name](), encoding="utf-8")
    assert faults_of(window, file) == []
    shown = window.run("return document.body.textContent")
    assert [text for text in texts if text not in shown] == []
