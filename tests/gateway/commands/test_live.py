"""live: a page beside a bus, until a person ends it or the page is gone; what cannot be watched is one sentence."""

from __future__ import annotations

import os
import re
import shutil
import signal
import urllib.request
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main
from gateway.live.page import LivePage
from sim.serve import free_bus

SMALL = Path(__file__).parents[3] / "examples" / "small"
WATCH = "gateway.live.watching.watch"


@pytest.fixture
def cell(tmp_path) -> Path:
    for name in ("robot.urdf", "cell.toml"):
        shutil.copy(SMALL / name, tmp_path / name)
    return tmp_path / "cell.toml"


def live(cell: Path, *more: str):
    return CliRunner().invoke(main, ["live", str(cell), *more])


def test_ctrl_c_is_how_it_ends(cell, monkeypatch):
    shown: list[str] = []

    def interrupted(loaded, specs, feed, recording) -> None:
        shown.append(loaded.cell.name)
        raise KeyboardInterrupt

    monkeypatch.setattr(WATCH, interrupted)
    done = live(cell)
    assert done.exit_code == 0, done.output
    assert re.search(r"live page: http://127\.0\.0\.1:\d+/\?token=\S+", done.stdout)
    assert "read only, nothing is sent" in done.output
    assert "ended" in done.output
    assert shown == ["small"]


def test_the_page_says_that_it_only_watches(cell, monkeypatch, pages):
    seen: list[int] = []

    def looked_at(_loaded, _specs, feed, _recording) -> None:
        assert not feed.gone
        page = pages[0]
        with urllib.request.urlopen(page.address, timeout=30.0) as answer:
            seen.append(answer.status)
        os.kill(page.process.pid, signal.SIGKILL)
        while not feed.gone:
            feed.pressed()

    monkeypatch.setattr(WATCH, looked_at)
    done = live(cell)
    assert done.exit_code == 0, done.output
    assert seen == [200]
    assert "the process of the page has stopped" in done.output


def test_a_bus_without_traffic_is_watched_until_the_page_is_gone(cell, monkeypatch):
    """Nothing is faked but the time at which the page goes: at once."""
    before = LivePage.__init__

    def killed(page, *arguments, **named) -> None:
        before(page, *arguments, **named)
        os.kill(page.process.pid, signal.SIGKILL)

    monkeypatch.setattr(LivePage, "__init__", killed)
    done = live(cell, "--bus", free_bus())
    assert done.exit_code == 0, done.output
    assert "the process of the page has stopped" in done.output
