"""The judge of logs: what is written is what was measured, and a table that is not is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.strangers import logs


@pytest.fixture
def layouts(monkeypatch) -> list[tuple[logs.Layout, logs.Run]]:
    """Layouts at rest, of a run whose load is not estimated here."""
    monkeypatch.setattr(logs, "sound", lambda _moving: (0,))
    monkeypatch.setattr(logs, "ONE_MOVING_OF", 10**9)
    monkeypatch.setattr(logs, "load_inside", lambda *_: "")
    return [logs.draw(seed) for seed in range(1, 13)]


def test_layouts_are_imported_as_written_or_refused_as_expected(layouts, tmp_path: Path) -> None:
    spoilt = 0
    for number, (layout, run) in enumerate(layouts):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert not logs.judge(layout, run, folder), layout.odd
        spoilt += bool(layout.refused)
    assert 1 <= spoilt <= 6


def test_the_judge_finds_another_number_and_a_log_that_is_taken_although_it_is_spoilt(layouts, tmp_path: Path) -> None:
    layout, run = next(each for each in layouts if not each[0].refused)
    other = replace(run, q_rad=run.q_rad + np.eye(1, 6) * 1e-4)
    assert "is not what was written" in logs.judge(layout, other, tmp_path)
    layout.refused = "anything"
    (tmp_path / "t.csv").unlink()
    assert "not refused as expected" in logs.judge(layout, run, tmp_path)
