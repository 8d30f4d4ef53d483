"""Six makes on one bus: `check` passes, and names the one drive that is not as its profile says, with a remedy."""

from __future__ import annotations

import re

import pytest

from sim.fault import Fault
from sim.faults import act

MAKES = ("maxon-epos4", "kinco-fd123", "kollmorgen-akd-x00606", "generic-cia402", "elmo-gold", "novanta-emcl")
#: What is wrong with the first drive, and what its finding and remedy name.
WRONG = {
    "nothing": (lambda drive: None, ()),
    "another make": (lambda drive: drive.store.values.update({(0x1018, 1): 9}), ("vendor", "choose the profile")),
    "older firmware": (lambda drive: drive.store.values.update({(0x1018, 3): 9}), ("revision", "and firmware")),
    "object promised": (
        lambda drive: act([drive], Fault("object_absent", index=0x607A, code=0x06020000)),
        ("607A", "the EDS of this"),
    ),
    "mode stuck": (lambda drive: drive.alter_object((0x6061, 0), get=lambda: 1), ("shows mode 1", "see 0x6502")),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_the_drive_that_differs_is_named_with_what_to_do(place, serve, gateway, wrong):
    left, (spoil, says) = iter(MAKES), WRONG[wrong]
    text = place.cell.read_text(encoding="utf-8")
    place.cell.write_text(re.sub(r'profile = ".*"', lambda _: f'profile = "{next(left)}"', text), encoding="utf-8")
    drives = serve()
    spoil(drives.handle.simulation.arms[0].drives[0])
    prove = ("--prove-stop", "--yes") if wrong == "mode stuck" else ()  # the mode is set before motion alone
    done = gateway("check", place.cell, "--bus", drives.bus, *prove)
    (line, *_) = [line for line in done.output.splitlines() if line.startswith("error: ")] or ["error: node 1"]
    assert (done.exit_code == 0) == (wrong == "nothing"), done.output
    assert all(word in line for word in ("node 1", *says)), line
    assert "node 2" not in done.output
    assert drives.stand_still()
