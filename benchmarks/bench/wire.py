"""Figures of the bus: rate, incomplete epochs, CPU against canopen's PDO objects, jitter of the wall-clock mode."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import can

from benchmarks.bench.wire_canopen import DroppingNetwork, PdoMapExchange, answers, open_network
from benchmarks.bench.wire_responder import CHANNEL, NODES, responder
from benchmarks.figure import figure
from drives.bus import Bus, BusSpec, open_bus
from drives.busload import cycle_bits_worst
from drives.drive import DriveCommand
from drives.group import DriveGroup, GroupOptions
from drives.profile_file import load_profile
from drives.values import AxisSetup

#: Statusword, position and torque in one TPDO of eight bytes, as the wire limit assumes.
PROFILE = "maxon-epos4"
ROUNDS = 7


def figures(cycles: int = 100_000, seconds: float = 10.0) -> dict[str, dict[str, Any]]:
    """All figures of this part.

    Parameters
    ----------
    cycles : int
        Lockstep cycles for rate and incomplete epochs.
    seconds : float
        Length of each run in real time.
    """
    limit_hz = 1e6 / cycle_bits_worst([0, *[8] * 12])
    found: dict[str, dict[str, Any]] = {
        "wire_limit_hz": figure(int(limit_hz), "== 597", "1/s"),
    }
    with responder() as port:
        found |= _lockstep(port, cycles, 1.5 * limit_hz)
    with responder() as port, responder() as other:
        found |= _cpu_on_the_bus(port, other)
    found |= _codec()
    for rate_hz in (100, 250):
        with responder() as port:
            found |= _jitter(port, rate_hz, seconds)
    return found


@contextmanager
def _group(bus: Bus, pacing: str, period_s: float) -> Iterator[DriveGroup]:
    profile = load_profile(PROFILE)
    setups = [AxisSetup(node, profile, 1.0, 300.0) for node in NODES]
    # A machine that is busy with other things may leave many SYNCs unanswered: here they are counted, not stopped for.
    options = GroupOptions(unanswered_syncs=1_000_000)
    with DriveGroup(bus, setups, period_s, pacing, options=options) as group:  # type: ignore[arg-type]
        group.connect()
        group.configure()
        group.enable()
        yield group
        group.disable()


def _bus(port: int) -> Bus:
    return open_bus(BusSpec("udp_multicast", CHANNEL, options={"port": port}))


def _commands(group: DriveGroup) -> list[DriveCommand]:
    return [DriveCommand(drive.target_count * drive.scale.count_rad) for drive in group.drives]


def _lockstep(port: int, cycles: int, goal_hz: float) -> dict[str, dict[str, Any]]:
    with _bus(port) as bus, _group(bus, "lockstep", 0.004) as group:
        commands = _commands(group)
        before = group.statistics.incomplete
        rates = []
        for _ in range(10):
            start = time.perf_counter()
            for _ in range(cycles // 10):
                group.exchange(commands)
            rates.append(cycles // 10 / (time.perf_counter() - start))
        incomplete = group.statistics.incomplete - before
    rate = statistics.median(rates)
    return {
        "lockstep_rate_hz": figure(rate, f">= {goal_hz:.0f}", "1/s", _spread(rates)),
        f"incomplete_epochs_in_{cycles}": figure(incomplete, "== 0"),
    }


def _cpu_on_the_bus(port: int, other_port: int, cycles: int = 3000) -> dict[str, dict[str, Any]]:
    """CPU of this process per cycle, all its threads; both measurements take turns."""
    ours, theirs = [], []
    for _ in range(ROUNDS):
        with _bus(port) as bus, _group(bus, "lockstep", 0.004) as group:
            commands = _commands(group)
            ours.append(_cpu_us(lambda group=group, commands=commands: group.exchange(commands), cycles))
        network = open_network(other_port, CHANNEL)
        try:
            exchange = PdoMapExchange(network)
            theirs.append(_cpu_us(lambda exchange=exchange: exchange.cycle(1000), cycles))
        finally:
            network.disconnect()
    ratios = [mine / their for mine, their in zip(ours, theirs, strict=True)]
    ratio = statistics.median(ratios)
    return {
        "cpu_per_cycle_us": figure(statistics.median(ours), unit="us", interval=_spread(ours)),
        "cpu_per_cycle_pdomap_us": figure(statistics.median(theirs), unit="us", interval=_spread(theirs)),
        "cpu_ratio_to_pdomap": figure(ratio, "<= 0.75", interval=_spread(ratios)),
    }


def _cpu_us(cycle: Callable[[], object], cycles: int) -> float:
    for _ in range(cycles // 10):
        cycle()
    start = time.process_time()
    for _ in range(cycles):
        cycle()
    return (time.process_time() - start) / cycles * 1e6


class _Loopback:
    """An adapter that costs nothing: the answers to a SYNC are ready-made, everything else is dropped.

    Their time stamp is never before a SYNC.
    """

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sets = [
            [
                can.Message(arbitration_id=0x180 + node, data=data, is_extended_id=False, timestamp=4e9)
                for node, data in zip(NODES, answers(count), strict=True)
            ][::-1]
            for count in range(2)
        ]
        self.syncs = 0

    def send(self, message: can.Message) -> None:
        if message.arbitration_id == 0x080:
            self.syncs += 1
            self.waiting = self.sets[self.syncs % 2].copy()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.waiting.pop() if self.waiting else None

    def shutdown(self) -> None:
        self.waiting.clear()


class _Switch:
    """An adapter that passes everything on to another one, which may be changed."""

    def __init__(self, adapter: Any) -> None:
        self.adapter = adapter

    def send(self, message: can.Message) -> None:
        self.adapter.send(message)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.adapter.recv(timeout)

    def shutdown(self) -> None:
        self.adapter.shutdown()


def _codec(cycles: int = 5000) -> dict[str, dict[str, Any]]:
    """Codec and dispatch alone: frames are handed over in memory on both sides."""
    ours, theirs = [], []
    with responder() as port:
        wire = can.Bus(interface="udp_multicast", channel=CHANNEL, port=port, fd=False, hop_limit=0)
        switch = _Switch(wire)
        with Bus(switch, BusSpec("udp_multicast", CHANNEL)) as bus, _group(bus, "lockstep", 0.004) as group:
            commands = _commands(group)
            exchange = PdoMapExchange(DroppingNetwork(bus=None))
            frames = answers(1)
            switch.adapter = _Loopback()
            for _ in range(ROUNDS):
                ours.append(_cpu_us(lambda: group.exchange(commands), cycles))
                theirs.append(_cpu_us(lambda: exchange.cycle_without_bus(1000, frames), cycles))
            switch.adapter = wire
    ratios = [mine / their for mine, their in zip(ours, theirs, strict=True)]
    ratio = statistics.median(ratios)
    return {
        "codec_us": figure(statistics.median(ours), unit="us", interval=_spread(ours)),
        "codec_pdomap_us": figure(statistics.median(theirs), unit="us", interval=_spread(theirs)),
        "codec_ratio_to_pdomap": figure(ratio, "<= 0.3", interval=_spread(ratios)),
    }


def _jitter(port: int, rate_hz: int, seconds: float) -> dict[str, dict[str, Any]]:
    with _bus(port) as bus, _group(bus, "real", 1.0 / rate_hz) as group:
        commands = _commands(group)
        before = group.statistics
        start = time.process_time()
        for _ in range(int(rate_hz * seconds)):
            group.exchange(commands)
        load = (time.process_time() - start) / seconds * 100.0
        after = group.statistics
    return {
        f"jitter_p50_us_{rate_hz}hz": figure((after.jitter_p50_s or 0.0) * 1e6, unit="us"),
        f"jitter_p99_us_{rate_hz}hz": figure((after.jitter_p99_s or 0.0) * 1e6, unit="us"),
        f"incomplete_{rate_hz}hz": figure(after.incomplete - before.incomplete),
        f"overruns_{rate_hz}hz": figure(after.overruns - before.overruns),
        f"cpu_percent_{rate_hz}hz": figure(load, unit="%"),
    }


def _spread(values: list[float]) -> list[float]:
    return [min(values), max(values)]
