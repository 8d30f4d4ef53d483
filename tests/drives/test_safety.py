"""What a profile says must hold for motion: emergency stop, safe torque off, a referenced encoder."""

from __future__ import annotations

import pytest

from drives.errors import DriveFault, ProfileError
from drives.profile_file import parse_profile, profile_schema
from drives.values import AxisSetup
from tests.drives.conftest import configured

SAFETY = """
[[safety]]
what = "STO"
object = { index = 0x2600, subindex = 1, type = "u16" }
mask = 0x3
good = 0x1
source = "manual"

[[safety]]
what = "emergency stop"
object = { index = 0x60FD, subindex = 0, type = "u32" }
mask = 0x00010000
good = 0x00010000

[reference]
object = { index = 0x2601, subindex = 0, type = "u8" }
mask = 0x80
good = 0x80
"""


def with_safety(generic, text=SAFETY):
    plain = generic.text.replace('eds = "generic-cia402.eds"\n', "")
    return parse_profile(plain + text, "here.toml")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((0x01, 0x00010000, 0x80), []),
        ((0xF1, 0xFFFFFFFF, 0xFF), []),
        ((0x03, 0x00010000, 0x80), ["STO: 2600:01 & 0x3 is 0x3 instead of 0x1"]),
        ((0x00, 0, 0x7F), ["STO", "emergency stop: 60FD:00", "the encoder is not referenced: 2601:00"]),
    ],
)
def test_a_drive_is_enabled_only_while_its_safety_chain_is_closed(bus, make_slave, generic, values, said):
    slave = make_slave(1)
    addresses = (((0x2600, 1), "u16"), ((0x60FD, 0), "u32"), ((0x2601, 0), "u8"))
    for (address, kind), value in zip(addresses, values, strict=True):
        slave.types[address], slave.values[address] = kind, value
    with configured(bus, [AxisSetup(1, with_safety(generic), 0.5, 300.0)], 0.004) as group:
        faults = group.drives[0].safety_faults()
        assert len(faults) == len(said)
        assert all(text in fault for text, fault in zip(said, faults, strict=True))
        if not said:
            assert group.enable().complete
            return
        state = group.gate(full=True)
        assert state.safe_to_approach, "a person may open the safety chain to work at the arm"
        assert not state.safe_to_power
        with pytest.raises(DriveFault, match=f"node 1: must not move: {said[0].split(':')[0]}") as caught:
            group.enable()
        assert all(text in str(caught.value) for text in said)
    assert slave.controlwords == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("good = 0x1\n", "good = 0x4\n", "does not look at"),
        ("mask = 0x3\n", "mask = 0x10003\n", "wider than the object"),
        ("mask = 0x3\n", "mask = 0\n", "must be more than 0"),
        ('what = "STO"\n', "", "what"),
        ('what = "STO"\n', 'what = "STO"\nwhen = 1\n', "when"),
    ],
)
def test_a_safety_condition_that_makes_no_sense_is_refused(generic, old, new, message):
    with pytest.raises(ProfileError, match=message):
        with_safety(generic, SAFETY.replace(old, new))


def test_safety_objects_are_looked_up_in_the_data_sheet(generic):
    with pytest.raises(ProfileError, match="2600:01 is not in it"):
        parse_profile(generic.text + SAFETY, "here.toml")


def test_the_schema_describes_safety_and_reference():
    schema = profile_schema()
    assert {"safety", "reference"} <= set(schema["properties"])
    assert {"SafetyCondition", "Reference"} <= set(schema["$defs"])
