"""`drive test` finds nothing wrong with good drives of another implementation."""

from __future__ import annotations

import json

import pytest

from tests.vcan.independent.conftest import EMULATED

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.clock]


@pytest.mark.skipif(EMULATED, reason="times are measured: an emulated processor is too slow")
def test_good_drives_have_no_finding(place, drives):
    """All drives of one variant; of the other, which differs in its SDO answers only, one drive."""
    out, one = place.folder / "drive-test", drives.variant == "no-size"
    place.types("drive", "test", place.cell, *(["--axis", "J2"] if one else []), "--yes", "--force", "-o", out)
    reports = [json.loads(path.read_text()) for path in sorted(out.glob("J*.json"))]
    assert [report["node"] for report in reports] == ([2] if one else [1, 2, 3, 4, 5, 6])
    for report in reports:
        assert report["findings"] == []
        figures = {each["name"]: each["interval"] for each in report["figures"]}
        low, high = figures["quick_stop_time_s"]
        assert 0.0 <= low < high < 0.2
        low, high = figures["heartbeat_loss_to_standstill_s"]
        assert 0.4 < low < high < 0.8
