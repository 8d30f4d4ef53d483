"""The page of a fleet as a browser draws it; with `--pictures` its picture is the one in the documentation."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.conftest import PICTURES
from tests.support.pages.browser import MISSING, Browser, available
from tests.support.pages.faults import WIDE_PX, show_whole
from tests.support.pages.fleet import fleet_pages

pytestmark = pytest.mark.skipif(not available(), reason=MISSING)
#: Texts of the drawings that are on the page and have a size.
DRAWN = """return [...document.querySelectorAll('svg text')]
    .filter(e => e.getBoundingClientRect().width > 0).map(e => e.textContent)"""
STATES = "return [...document.querySelectorAll('td .tag')].map(e => e.textContent)"


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return dict(fleet_pages())


def size_px(file: Path) -> tuple[int, int]:
    """Width and height of a PNG (its header, ISO/IEC 15948, 11.2.2)."""
    content = file.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", content[16:24])
    return width, height


def drawn_on(window: Browser, page: str, file: Path) -> list[str]:
    """Texts of the drawings of a page that has no faults, as wide as a screen."""
    show_whole(window, page, file)
    return window.run(DRAWN)


@pytest.mark.slow
def test_the_page_of_a_fleet_is_whole_and_its_picture_is_taken(
    window: Browser, pages: dict[str, str], tmp_path: Path, pictures: Path
) -> None:
    drawn = drawn_on(window, pages["fleet"], tmp_path / "fleet.html")
    assert "drift of the gain [% a year]" in drawn
    assert "robot, by position in the list" in drawn
    assert set(window.run(STATES)) == {"visit", "not seen", "cannot tell", "healthy"}
    window.picture(pictures / "fleet.png")
    taken, shown = size_px(pictures / "fleet.png"), size_px(PICTURES / "fleet.png")
    assert taken[0] == shown[0] == WIDE_PX
    assert taken[1] == pytest.approx(shown[1], rel=0.1), "taken again by python -m pytest --pictures"


@pytest.mark.slow
def test_every_panel_of_a_robot_says_what_it_shows_and_in_which_unit(
    window: Browser, pages: dict[str, str], tmp_path: Path
) -> None:
    drawn = drawn_on(window, pages["fleet-robot"], tmp_path / "robot.html")
    panels = window.run("return document.querySelectorAll('figure svg').length")
    assert panels == 4 * 6 + 3
    assert drawn.count("days since the first check [d]") == panels
    for label in ("J6 gain [1]", "J6 friction [Nm]", "J6 Coulomb [Nm]", "J6 viscous [Nm s/rad]", "weld mass [kg]"):
        assert label in drawn
