"""What the gateway wrote itself is judged as the engineer left it; what another tool wrote since, as it is."""

from __future__ import annotations

import pytest

from drives.ledger import LedgerEntry, WriteLedger
from drives.values import Identity
from gateway.errors import FindingFailed
from gateway.preflight.drive_check import as_left, require_passed
from gateway.result.result import Finding

DRIVE = Identity(3, 0x00020192, 2, 7, 0x10000, 55, "drive", "1", "2.3")


@pytest.mark.parametrize(
    ("serial", "found", "left"),
    [
        (55, 1200, 3750),
        (None, 1200, 3750),
        (56, 1200, 1200),
        (55, 2000, 2000),
        (55, None, None),
    ],
)
def test_a_value_of_ours_counts_as_before_and_any_other_as_it_is(serial, found, left):
    ledger = WriteLedger()
    ledger.note(LedgerEntry(3, 0x6072, 0, "u16", 3750, 1200, "lowest torque that the motion needs", serial))
    ledger.note(LedgerEntry(4, 0x607E, 0, "u8", 0, 0xC0, "another node"))
    readings = {(0x6072, 0): found, (0x607E, 0): 0xC0}
    assert as_left(readings, DRIVE, ledger) == {(0x6072, 0): left, (0x607E, 0): 0xC0}
    assert readings[0x6072, 0] == found


def test_the_first_failing_item_is_reported_and_the_others_are_counted():
    items = [Finding(kind, f"J{number}", "is wrong", "do this") for number, kind in enumerate(("ok", "fail", "fail"))]
    require_passed(items[:1], "nothing has moved")
    with pytest.raises(FindingFailed, match=r"^nothing has moved: J1: is wrong; do this \(and 1 more\)$"):
        require_passed(items, "nothing has moved")
