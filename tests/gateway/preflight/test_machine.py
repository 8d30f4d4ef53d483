"""Computer and bus: whether the SYNC can be kept, and who else can write to the drives."""

from __future__ import annotations

import pytest

from drives.bus import BusSpec
from drives.realtime import RealTimeStatus, available
from gateway.cell.config import BusConfig
from gateway.preflight.machine import (
    judge_bus,
    judge_lateness,
    judge_realtime,
    judge_surroundings,
    measure_lateness,
)


class Clock:
    """A clock of its own; every wait ends `delay_s` later."""

    def __init__(self, delay_s: float) -> None:
        self.now_s = 1000.0
        self.delay_s = delay_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds + self.delay_s

    def now(self) -> float:
        return self.now_s


def config(**changes):
    return BusConfig(interface="virtual", channel="c", sync_period_s=0.004, **changes)


def test_every_period_is_measured_from_the_start_so_that_lateness_does_not_add_up():
    clock = Clock(0.001)
    lateness = measure_lateness(0.004, clock.now, clock.sleep)
    assert len(lateness) == 75
    assert lateness == pytest.approx([0.001] * 75)


def test_a_loop_stalled_for_longer_than_a_period_is_delayed_at_the_periods_it_missed():
    clock = Clock(0.0)
    calls = iter(range(1000))
    lateness = measure_lateness(0.01, clock.now, lambda left: clock.sleep(left + (0.025 if next(calls) == 4 else 0.0)))
    assert [round(each, 4) for each in lateness[3:9]] == [0.0, 0.025, 0.015, 0.005, 0.0, 0.0]


@pytest.mark.parametrize(("delay_s", "severity"), [(0.0019, "ok"), (0.0021, "fail")])
def test_half_a_period_may_be_missed(delay_s, severity):
    item = judge_lateness([delay_s] * 75, 0.004)
    assert item.severity == severity
    assert bool(item.advice) == (severity == "fail")


def test_a_hundredth_of_the_periods_may_be_later():
    assert judge_lateness([0.0] * 199 + [0.1], 0.004).severity == "ok"
    assert judge_lateness([0.0] * 190 + [0.1] * 10, 0.004).severity == "fail"


def test_only_a_bus_that_the_clock_paces_is_measured():
    slow, spec = Clock(0.01), BusSpec("socketcan", "can0")
    real = judge_surroundings(config(pacing="real"), spec, slow.now, slow.sleep)
    assert [item.severity for item in real] == ["ok", "fail"]
    assert "raise sync_period_s" in real[1].advice
    lockstep = judge_surroundings(config(pacing="lockstep"), spec, slow.now, slow.sleep)
    assert [item.severity for item in lockstep] == ["ok"]


@pytest.mark.parametrize("interface", ["udp_multicast", "virtual", "socketcand"])
def test_a_network_is_called_one_and_real_drives_on_it_are_warned_of(interface):
    spec = BusSpec(interface, "somewhere")
    closed = judge_bus(config(), spec)
    assert {item.severity for item in closed} == {"info"}
    assert any("every host" in item.what and "only simulated" in item.what for item in closed)
    opened = [item for item in judge_bus(config(allow_real_drive=True), spec) if item.severity == "warn"]
    assert len(opened) == 1
    assert "allow_real_drive" in opened[0].what
    assert opened[0].advice


def test_frame_times_of_the_kernel_are_those_of_socketcan():
    assert [item.severity for item in judge_bus(config(), BusSpec("socketcan", "can0"))] == ["ok"]
    assert "not from the kernel" in judge_bus(config(), BusSpec("slcan", "/dev/ttyACM0"))[0].what


@pytest.mark.parametrize(
    ("status", "severity", "says"),
    [
        (RealTimeStatus(True, True, ""), "ok", "are allowed"),
        (RealTimeStatus(False, True, "no real-time scheduler"), "info", "no real-time scheduler"),
        (RealTimeStatus(True, False, "memory is not locked"), "info", "not locked"),
    ],
)
def test_what_the_system_allows_is_reported(status, severity, says):
    item = judge_realtime(status)
    assert item.severity == severity
    assert says in item.what
    assert bool(item.advice) == (severity != "ok")


def test_what_the_system_allows_is_reported_of_this_process():
    status = available()
    assert bool(status.why) != (status.fifo and status.locked)
