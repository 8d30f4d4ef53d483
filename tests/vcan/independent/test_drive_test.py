"""`check --timing` finds nothing wrong with good drives of another implementation."""

from __future__ import annotations

import json

import pytest

from tests.vcan.independent.conftest import on_buses

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.clock]


@on_buses(["zero-extended"], ["no-size"])
def test_good_drives_have_no_finding(place):
    """Two drives, one of them behind a gear that turns the other way: the others are of the same make."""
    out = place.folder / "drive-test"
    place.types("check", place.cell, "--timing", "--axis", "J1", "--axis", "J2", "--yes", "-o", out)
    reports = [json.loads(path.read_text()) for path in sorted(out.glob("J*.json"))]
    assert [report["node"] for report in reports] == [1, 2]
    for report in reports:
        assert report["findings"] == []
        figures = {each["name"]: each["interval"] for each in report["figures"]}
        low, high = figures["quick_stop_time_s"]
        assert 0.0 <= low < high < 0.2
        low, high = figures["heartbeat_loss_to_standstill_s"]
        assert 0.4 < low < high < 0.8
