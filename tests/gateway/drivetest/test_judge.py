"""What counts as a finding: beyond a limit with certainty, and not common to all drives."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gateway.drivetest.judge import judge
from gateway.drivetest.sheet import DriveSheet
from gateway.result.drive_test import TimingFigure

GOOD = {
    "controlword_to_reaction_s": (0.0002, 0.0, 0.001),
    "sync_to_tpdo_p05_s": (0.0003, 0.0002, 0.0004),
    "sync_to_tpdo_s": (0.0004, 0.0003, 0.0005),
    "sync_to_tpdo_p95_s": (0.0006, 0.0005, 0.0012),
    "sdo_answer_s": (0.0001, 0.0001, 0.0002),
    "torque_age_s": (0.002, 0.0, 0.008),
    "brake_drop_rad": (1e-5, 0.0, 2e-5),
    "missed_pdo_4ms": (0.0, 0.0, 0.007),
    "missed_pdo_10ms": (0.0, 0.0, 0.012),
    "late_pdo_10ms": (0.0, 0.0, 0.012),
}


def drives(*changes):
    """Three drives; `changes` of the second one."""
    profile = SimpleNamespace(torque=SimpleNamespace(filter_s=0.001), sdo=SimpleNamespace(timeout_s=0.3))
    drive = SimpleNamespace(setup=SimpleNamespace(profile=profile), node_id=1, identity=None)
    sheets = [DriveSheet(number, drive) for number in range(3)]
    for number, sheet in enumerate(sheets):
        values = GOOD | (dict(changes) if number == 1 else {})
        for name, (value, low, high) in values.items():
            unit = "rad" if name.endswith("_rad") else "1" if "_pdo_" in name else "s"
            sheet.figures.append(TimingFigure(name, value, (low, high), unit, 10, "drawn"))
    return sheets


def test_good_drives_have_no_finding():
    sheets = drives()
    judge(sheets, 0.01)
    assert [sheet.findings for sheet in sheets] == [[], [], []]


@pytest.mark.parametrize(
    ("name", "figure", "text"),
    [
        (
            "controlword_to_reaction_s",
            (0.03, 0.025, 0.035),
            "time from controlword to reaction is 30 ms (25 ms to 35 ms)",
        ),
        ("sync_to_tpdo_s", (0.004, 0.0038, 0.0042), "time from SYNC to TPDO is 4 ms"),
        ("sync_to_tpdo_p95_s", (0.004, 0.0038, 0.0042), "varies by at least 3.4 ms"),
        ("sdo_answer_s", (0.2, 0.19, 0.21), "time of an SDO answer"),
        ("torque_age_s", (0.02, 0.012, 0.028), "age of the torque word"),
        ("brake_drop_rad", (0.004, 0.0039, 0.0041), "drop in the brake is 0.004 rad"),
        ("missed_pdo_10ms", (0.03, 0.014, 0.06), "missed TPDOs at 10 ms: 3 %"),
        ("late_pdo_10ms", (0.03, 0.014, 0.06), "delayed TPDOs at 10 ms"),
    ],
)
def test_a_figure_beyond_its_limit_is_a_finding_of_that_drive_alone(name, figure, text):
    sheets = drives((name, figure))
    judge(sheets, 0.01)
    (found,) = sheets[1].findings
    assert text in found
    assert sheets[0].findings == sheets[2].findings == []


@pytest.mark.parametrize(
    ("name", "figure"),
    [
        ("controlword_to_reaction_s", (0.03, 0.015, 0.045)),  # the interval holds the limit
        ("missed_pdo_4ms", (0.3, 0.26, 0.34)),  # faster than the cell asks for
    ],
)
def test_what_is_not_certain_or_not_asked_for_is_no_finding(name, figure):
    sheets = drives((name, figure))
    judge(sheets, 0.01)
    assert sheets[1].findings == []


def test_what_all_drives_have_in_common_is_of_the_bus():
    sheets = drives()
    for sheet in sheets:
        sheet.figures.insert(0, TimingFigure("missed_pdo_10ms", 0.03, (0.014, 0.06), "1", 300, "drawn"))
    judge(sheets, 0.01)
    assert all(sheet.findings == [] for sheet in sheets)
