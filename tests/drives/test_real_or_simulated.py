"""Lockstep, and buses that are networks, are for nodes that say that they are simulated."""

from __future__ import annotations

import dataclasses

import pytest

from drives.bus import Bus, BusSpec
from drives.errors import ConfigurationRefused, SeveralFailures
from drives.group import DriveGroup, GroupOptions

PERIOD_S = 0.004
SIMULATED = (0x5FFE, 0)


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(3)


def connect(bus, setups, pacing, options=None):
    with DriveGroup(bus, setups(3), PERIOD_S, pacing, options=options) as group:
        group.connect()


@pytest.mark.parametrize("says", [None, b"servo", b""])
@pytest.mark.parametrize("options", [None, GroupOptions(allow_real_drive=True)])
def test_lockstep_is_refused_with_one_drive_that_is_no_simulator(bus, slaves, setups, wire, says, options):
    if says is None:
        del slaves[1].texts[SIMULATED]
    else:
        slaves[1].texts[SIMULATED] = says
    with pytest.raises(ConfigurationRefused, match='node 2: .*pacing = "real"'):
        connect(bus, setups, "lockstep", options)
    assert {can_id for can_id, _ in wire.sent} <= {0x601, 0x602, 0x603, 0x000}
    assert [slave.written for slave in slaves] == [[]] * 3


def test_every_drive_that_is_real_is_named(bus, slaves, setups):
    for slave in slaves[1:]:
        del slave.texts[SIMULATED]
    with pytest.raises(SeveralFailures, match=r"nodes 2, 3: is not a simulator"):
        connect(bus, setups, "lockstep")


def test_by_the_clock_a_real_drive_is_welcome(bus, slaves, setups):
    del slaves[1].texts[SIMULATED]
    connect(bus, setups, "real")


@pytest.mark.parametrize("interface", ["udp_multicast", "virtual", "socketcand", "socketcan"])
def test_a_real_drive_on_a_network_needs_leave(wire, slaves, setups, interface):
    del slaves[1].texts[SIMULATED]
    with Bus(wire, BusSpec(interface, "a")) as bus:
        if interface == "socketcan":
            connect(bus, setups, "real")
            return
        with pytest.raises(ConfigurationRefused, match="node 2: .*any computer on .* can write frames") as caught:
            connect(bus, setups, "real")
        assert "allow_real_drive" in caught.value.advice
        connect(bus, setups, "real", GroupOptions(allow_real_drive=True))


def test_simulated_drives_need_no_leave(wire, slaves, setups):
    with Bus(wire, BusSpec("virtual", "a")) as bus:
        connect(bus, setups, "lockstep")
        connect(bus, setups, "real")


def test_leave_is_not_given_by_itself():
    assert {field.name: field.default for field in dataclasses.fields(GroupOptions)}["allow_real_drive"] is False
