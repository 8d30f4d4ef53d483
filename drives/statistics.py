"""Statistics of a run on the bus: counts, latencies, load, jitter."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from drives.busload import load_percent
from drives.emcy import Emergency
from drives.exchange import SyncExchange
from drives.nodes import Nodes
from drives.sdo import SdoStatistics


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """Counters and latencies of a drive group.

    Attributes
    ----------
    cycles, incomplete : int
        SYNCs sent, and those that not every axis answered.
    late, duplicate, ambiguous, wrong_length : int
        TPDOs that came after their SYNC was closed, twice, twice with different content, with a wrong length.
    unsure : int
        TPDOs in real time that may belong to an earlier unanswered SYNC, and were not assigned.
    overruns : int
        SYNC periods missed in real time.
    warnings : int
        Answers in which a drive warns (statusword bit 7).
    foreign : dict
        Frames of another master by CAN id.
    frames : dict
        Odd frames by kind: malformed, error, remote, extended, unclaimed, send_retries.
    sdo : tuple of SdoStatistics
        One per axis.
    emcy : tuple of Emergency
        The last messages.
    emcy_count : int
        All of them.
    bus_load_planned_percent : float
        Worst case of the planned exchange.
    bus_load_measured_percent : float or None
        Worst-case bits of what was exchanged over the time since the first SYNC; None before the second.
    jitter_p50_s, jitter_p99_s : float or None
        Delay of sent SYNCs in real time; None in lockstep.
    """

    cycles: int
    incomplete: int
    late: int
    duplicate: int
    ambiguous: int
    wrong_length: int
    unsure: int
    overruns: int
    warnings: int
    foreign: dict[int, int]
    frames: dict[str, int]
    sdo: tuple[SdoStatistics, ...]
    emcy: tuple[Emergency, ...]
    emcy_count: int
    bus_load_planned_percent: float
    bus_load_measured_percent: float | None
    jitter_p50_s: float | None
    jitter_p99_s: float | None


def group_statistics(nodes: Nodes, exchange: SyncExchange | None) -> GroupStatistics:
    """Return the counters of a group; counters of the exchange are zero before it exists."""
    counts: Counter[str] = Counter() if exchange is None else exchange.collector.counts
    bus, emcy, bitrate = nodes.bus, nodes.emcy, nodes.bus.spec.bitrate_bit_s
    planned, measured, lateness, overruns = 0.0, None, (), 0
    if exchange is not None:
        planned = load_percent(nodes.cycle_bits, nodes.timing.period_s, bitrate)
        if exchange.started_s is not None and exchange.cycles > 1:
            elapsed_s = time.monotonic() - exchange.started_s
            measured = load_percent(exchange.cycles * nodes.cycle_bits, elapsed_s, bitrate)
        lateness, overruns = tuple(exchange.clock.lateness_s), exchange.clock.overruns
    return GroupStatistics(
        cycles=0 if exchange is None else exchange.cycles,
        incomplete=0 if exchange is None else exchange.incomplete,
        late=counts["late"],
        duplicate=counts["duplicate"],
        ambiguous=counts["ambiguous"],
        wrong_length=counts["wrong_length"],
        unsure=counts["unsure"],
        overruns=overruns,
        warnings=0 if exchange is None else exchange.warnings,
        foreign=dict(bus.foreign),
        frames=dict(bus.counts),
        sdo=tuple(drive.access.sdo.statistics for drive in nodes.drives),
        emcy=emcy.messages,
        emcy_count=emcy.count,
        bus_load_planned_percent=planned,
        bus_load_measured_percent=measured,
        jitter_p50_s=quantile(lateness, 0.5),
        jitter_p99_s=quantile(lateness, 0.99),
    )


def quantile(values: Sequence[float], share: float) -> float | None:
    """Return the smallest value that at least `share` of the values do not exceed; None without values."""
    if not values:
        return None
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, -int(-share * len(ordered) // 1) - 1))]
