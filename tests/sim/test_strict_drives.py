"""Strict, talkative and broken drives, each from its scenario file, judged on the wire."""

from __future__ import annotations

import math
import struct
from types import SimpleNamespace

import pytest

from sim.faults import KINDS, act, fault_of
from sim.node import OPERATIONAL, PRE_OPERATIONAL
from tests.sim.conftest import Master, Start, drive_of

NODE, OTHER = 2, 3


def emergencies(master: Master, can_id: int) -> list[int]:
    return [struct.unpack_from("<H", frame.data)[0] for frame in master.drain() if frame.arbitration_id == can_id]


def test_an_inhibit_time_is_taken_only_while_the_pdo_does_not_exist(start: Start) -> None:
    with start("strict_inhibit") as (master, _):
        assert master.number(NODE, 0x1800, 3) == 100
        with pytest.raises(master.Aborted) as caught:
            master.write(NODE, 0x1800, 3, 0, 2)
        assert caught.value.code == 0x06090030
        with pytest.raises(master.Aborted) as caught:
            master.write(OTHER, 0x1800, 3, 0, 2)
        assert caught.value.code == 0x08000022
        master.write(NODE, 0x1800, 1, 0x80000180 | NODE, 4)
        master.write(NODE, 0x1800, 3, 0, 2)
        assert master.number(NODE, 0x1800, 3) == 0
        master.send(0x000, bytes([129, NODE]))
        assert master.wait(0x700 + NODE) == b"\x00"
        assert master.number(NODE, 0x1800, 3) == 100


def test_start_is_refused_until_the_communication_error_has_gone(start: Start, monkeypatch) -> None:
    with start("start_refused", delay_s=0.7) as (master, simulation):
        drive, now = drive_of(simulation), [50.0]
        monkeypatch.setattr("sim.drive_faults.time", SimpleNamespace(monotonic=lambda: now[0]))
        for elapsed_s in (0.0, 0.69):
            now[0] = 50.0 + elapsed_s
            master.send(0x000, bytes([1, 0]))
            assert emergencies(master, 0x80 + NODE) == [0x8100]
            assert master.number(NODE, 0x1001) & 0x10
            assert drive.node.state == PRE_OPERATIONAL
        assert drive_of(simulation, OTHER).node.state == OPERATIONAL
        now[0] = 50.71
        master.send(0x000, bytes([1, 0]))
        assert emergencies(master, 0x80 + NODE) == [0]
        assert master.number(NODE, 0x1001) == 0
        assert drive.node.state == OPERATIONAL


def test_start_may_be_refused_for_ever(start: Start, monkeypatch) -> None:
    with start("start_never") as (master, simulation):
        drive, now = drive_of(simulation), [0.0]
        monkeypatch.setattr("sim.drive_faults.time", SimpleNamespace(monotonic=lambda: now[0]))
        for now[0] in (1.0, 1e9):
            master.send(0x000, bytes([1, NODE]))
            master.wait(0x80 + NODE)
        assert drive.node.state == PRE_OPERATIONAL


@pytest.mark.parametrize(("code", "stays"), [(None, False), (8000, True), (10_000, True), (21_000, False)])
def test_another_sync_period_than_0x1006_says_ends_operational(start: Start, code: int | None, stays: bool) -> None:
    with start("cycle_period_set", **{} if code is None else {"code": code}) as (master, simulation):
        assert master.number(NODE, 0x1006) == (code or 1000)
        master.configure(NODE, 8)
        master.drain()
        master.sync(10)
        assert emergencies(master, 0x80 + NODE) == ([] if stays else [0x8100])
        assert (drive_of(simulation).node.state == OPERATIONAL) == stays
        master.write(NODE, 0x1006, 0, 0, 4)
        master.send(0x000, bytes([1, NODE]))
        master.sync(10)
        master.number(NODE, 0x1000)
        assert drive_of(simulation).node.state == OPERATIONAL


@pytest.mark.parametrize(("index", "refused"), [(0, (0x6502, 0x1029)), (0x60FD, (0x60FD,))])
def test_optional_objects_may_have_no_data(start: Start, index: int, refused: tuple[int, ...]) -> None:
    with start("no_data_abort", index=index) as (master, _):
        for wanted in refused:
            with pytest.raises(master.Aborted) as caught:
                master.read(NODE, wanted)
            assert caught.value.code == 0x08000024
        assert master.number(NODE, 0x6041) & 0x4F == 0x40
        assert master.number(OTHER, 0x6502)


@pytest.mark.parametrize(("keys", "rate_hz"), [({}, 5000), ({"rate_hz": 300.0}, 300)])
def test_a_third_tpdo_sends_at_its_rate_until_it_is_switched_off(start: Start, keys: dict, rate_hz: int) -> None:
    with start("tpdo3_on", **keys) as (master, _):
        assert master.number(NODE, 0x1802, 1) == 0x380 + NODE
        assert master.number(OTHER, 0x1802, 1) >> 31
        master.send(0x000, bytes([1, NODE]))
        master.drain()
        master.sync(40)
        frames = [frame for frame in master.drain() if frame.arbitration_id == 0x380 + NODE]
        assert len(frames) == pytest.approx(0.4 * rate_hz, rel=0.04)
        assert len(frames[0].data) == 6
        master.write(NODE, 0x1802, 1, 0x80000380 | NODE, 4)
        master.drain()
        master.sync(10)
        assert not [frame for frame in master.drain() if frame.arbitration_id == 0x380 + NODE]


def complain(master: Master) -> None:
    """Make a drive send an EMCY: a command that is too short."""
    master.configure(NODE, 8)
    master.send(0x200 + NODE, b"\x06")
    master.sync()


def test_emergencies_come_where_0x1014_says(start: Start) -> None:
    with start("foreign_emcy_id") as (master, _):
        assert master.number(NODE, 0x1014) == 0xA0 + NODE
        complain(master)
        assert struct.unpack_from("<H", master.wait(0xA0 + NODE))[0] == 0x8210
        with pytest.raises(master.Aborted) as caught:
            master.write(NODE, 0x1014, 0, 0x80 + NODE, 4)
        assert caught.value.code == 0x08000022
        master.write(NODE, 0x1014, 0, 0x80000080 + NODE, 4)
        master.write(NODE, 0x1014, 0, 0x80 + NODE, 4)
        master.send(0x200 + NODE, b"\x06")
        assert struct.unpack_from("<H", master.wait(0x80 + NODE))[0] == 0x8210


def test_emergencies_can_be_switched_off(start: Start) -> None:
    with start("emcy_disabled") as (master, _):
        assert master.number(NODE, 0x1014) == 0x80000080 + NODE
        complain(master)
        assert emergencies(master, 0x80 + NODE) == []
        assert master.number(NODE, 0x1003, 1) & 0xFFFF == 0x8210


def test_a_pressed_emergency_stop_is_seen_and_nothing_is_switched_on(start: Start) -> None:
    with start("estop_pressed") as (master, _):
        assert [master.number(node, 0x60FD) >> 24 & 1 for node in (NODE, OTHER)] == [0, 1]
        master.configure(NODE, 8)
        for word in (0x06, 0x07, 0x0F):
            status, _, _ = master.cycle(NODE, word, 0)
            assert status & 0x4F == 0x40


def test_a_lost_reference_is_seen(start: Start) -> None:
    with start("unreferenced") as (master, _):
        assert [master.number(node, 0x60FD) >> 25 & 1 for node in (NODE, OTHER)] == [0, 1]


def test_a_drive_without_heartbeat_takes_the_time_and_sends_none(start: Start) -> None:
    with start("no_heartbeat") as (master, _):
        for node in (NODE, OTHER):
            master.write(node, 0x1017, 0, 20, 2)
        assert master.number(NODE, 0x1017) == 20
        master.sync(20)
        beating = {frame.arbitration_id for frame in master.drain()}
        assert 0x700 + OTHER in beating
        assert 0x700 + NODE not in beating


def states(master: Master, cycles: int) -> list[int]:
    position = master.number(NODE, 0x6064, signed=True)
    return [master.cycle(NODE, word, position)[0] & 0x6F for word in (0x06, 0x07, *[0x0F] * cycles)]


def test_a_drive_that_drops_out_does_so_every_time(start: Start) -> None:
    with start("enables_and_drops") as (master, _):
        master.configure(NODE, 8)
        seen = states(master, 40)[3:]
        runs = "".join("e" if state == 0x27 else "s" for state in seen).split("s")
        assert {0x27, 0x23} == set(seen)
        assert max(len(run) for run in runs) <= 3
        assert seen.count(0x23) >= 5


def test_a_drive_that_never_enables_stays_switched_on(start: Start) -> None:
    with start("never_enables") as (master, simulation):
        master.configure(NODE, 8)
        assert set(states(master, 40)[2:]) == {0x23}
        assert not drive_of(simulation).axis.free


@pytest.mark.parametrize(("keys", "rad_s"), [({}, 0.05), ({"speed_rad_s": 0.005}, 0.005)])
def test_a_brake_that_slips_lets_the_axis_sink_at_its_rate(start: Start, keys: dict, rad_s: float) -> None:
    with start("brake_slips", **keys) as (master, simulation):
        axis = drive_of(simulation).axis
        master.sync(5)
        master.number(NODE, 0x1000)
        before, load = axis.position_rad, axis.torque_nm
        master.sync(50)
        master.number(NODE, 0x1000)
        assert not axis.free
        assert axis.position_rad - before == pytest.approx(-0.5 * rad_s if load > 0 else 0.5 * rad_s, rel=0.1)
        assert axis.fastest_rad_s == pytest.approx(rad_s)


@pytest.mark.parametrize(("keys", "rad_s2"), [({}, 5.0), ({"accel_rad_s2": 2.0}, 2.0), ({"accel_rad_s2": 10.0}, 10.0)])
def test_a_brake_that_fails_lets_the_axis_fall_once_it_was_opened(start: Start, keys: dict, rad_s2: float) -> None:
    """It accelerates in the direction of its load, from the SYNC at which its brake should have closed."""
    with start("brake_falls", **keys) as (master, simulation):
        axis = drive_of(simulation).axis
        master.sync(5)
        master.number(NODE, 0x1000)
        before = axis.position_rad
        master.configure(NODE, 8)
        states(master, 20)
        assert axis.position_rad == pytest.approx(before, abs=2e-3)
        before, load = axis.position_rad, axis.torque_nm
        target = master.number(NODE, 0x6064, signed=True)
        for _ in range(11):
            target = master.cycle(NODE, 0x07, target)[1]
        fallen = axis.position_rad - before
        assert fallen == pytest.approx(math.copysign(0.5 * rad_s2 * 0.1**2, -load), rel=0.25)
        for _ in range(60):
            status, _, _ = master.cycle(NODE, 0x0F, target)
        assert status & 0x6F == 0x27
        assert axis.fed
        assert abs(axis.omega_rad_s) < 0.05


def test_a_repaired_drive_is_as_new(start: Start) -> None:
    with start("tpdo3_on") as (master, simulation):
        drive = drive_of(simulation)
        for kind in [kind for kind, about in KINDS.items() if about.where in ("object", "mechanics")]:
            act([drive], fault_of(kind, node=NODE))
        drive.repair()
        assert master.number(NODE, 0x1018, 4) == drive.serial
        assert master.number(NODE, 0x1802, 1) >> 31
        assert master.number(NODE, 0x60FD) >> 24 & 1
        master.configure(NODE, 8)
        assert states(master, 10)[-1] == 0x27
