"""What bring-up says that it does is what it does."""

from __future__ import annotations

import re

from drives.bringup import steps
from drives.group import DriveGroup


def test_every_object_that_bring_up_writes_is_named_in_its_steps(bus, add_slaves, setups):
    """Records of the PDOs count as the area that is named."""
    add_slaves(2)
    named = {int(text, 16) for step in steps() for text in re.findall(r"0x([0-9A-F]{4})", step)}
    with DriveGroup(bus, setups(2), 0.004) as group:
        group.connect()
        assert group.ledger.entries == ()
        group.configure()
        written = {entry.index for entry in group.ledger.entries}
    areas = {index & ~0x1FF for index in written if 0x1400 <= index < 0x1C00}
    assert written
    assert areas | {index for index in written if not 0x1400 <= index < 0x1C00} <= named


def test_the_steps_are_listed_in_the_order_in_which_they_run(bus, add_slaves, setups):
    add_slaves(1)
    ran: list[int] = []
    with DriveGroup(bus, setups(1), 0.004) as group:
        group.connect()
        (drive,) = group.drives
        plain = drive.access.sdo.write
        drive.access.sdo.write = lambda index, *rest: (ran.append(index), plain(index, *rest))[1]
        group.configure()
    step_of = {
        int(text, 16): number for number, step in enumerate(steps()) for text in re.findall(r"0x([0-9A-F]{4})", step)
    }
    order = [step_of[0x1400 if 0x1400 <= index < 0x1C00 else index] for index in ran]
    assert len(set(order)) > 3
    assert order == sorted(order)
