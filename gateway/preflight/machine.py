"""The computer and the bus it sits at: can it keep the SYNC period, and who else can write to the drives?"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from drives.bus import BusSpec
from drives.bus_spec import NETWORKS
from drives.realtime import RealTimeStatus
from gateway.cell.config import BusConfig
from gateway.result.result import Finding

#: How long a bare timer loop is measured [s], and what share of a period its 99 % may be late.
MEASURE_S: Final = 0.3
LATE_SHARE: Final = 0.5


@dataclass(frozen=True, slots=True)
class Timer:
    """Monotonic time [s] and a way to wait."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def measure_lateness(period_s: float, timer: Timer | None = None) -> list[float]:
    """How late a bare loop wakes at each of its periods.

    Parameters
    ----------
    period_s : float
    timer : Timer, optional
        The system's if none is given.

    Returns
    -------
    list of float
        One per period [s].
    """
    timer = timer or Timer()
    start = timer.now()
    late: list[float] = []
    for number in range(1, max(2, round(MEASURE_S / period_s)) + 1):
        due = start + number * period_s
        while (left := due - timer.now()) > 0.0:
            timer.sleep(left)
        late.append(timer.now() - due)
    return late


def judge_lateness(late_s: Sequence[float], period_s: float) -> Finding:
    """Whether a SYNC of this period can be kept here.

    Parameters
    ----------
    late_s : sequence of float
        As `measure_lateness` gives it.
    period_s : float
    """
    p99_s = float(np.percentile(late_s, 99))
    what = (
        f"this computer wakes a loop of {1000 * period_s:g} ms up to {1000 * p99_s:.2g} ms late (99 % of {len(late_s)}"
        " cycles)"
    )
    if p99_s > LATE_SHARE * period_s:
        return Finding("fail", "computer", what, "raise sync_period_s or free this computer")
    return Finding("ok", "computer", what)


def judge_realtime(status: RealTimeStatus) -> Finding:
    """Whether the loop may run with real-time priority in locked memory."""
    if status.fifo and status.locked:
        return Finding("ok", "computer", "real-time scheduling (SCHED_FIFO) and locked memory are allowed")
    advice = "permit both: else other programs of this computer may delay the SYNC"
    return Finding("info", "computer", status.why, advice)


def judge_bus(config: BusConfig, spec: BusSpec) -> list[Finding]:
    """Whose the frame times are, and who can write to this bus.

    Parameters
    ----------
    config : BusConfig
        Of the cell.
    spec : BusSpec
        The bus that is used.
    """
    if spec.interface == "socketcan":
        return [Finding("ok", "bus", "frame times are the kernel's")]
    items = [Finding("info", "bus", f"{spec.interface}: frame times are those of its driver, not of the kernel")]
    if spec.interface in NETWORKS:
        what = f"{spec} is a network: anybody on it can write frames, a controlword too"
        if config.allow_real_drive:
            advice = "keep everybody else off this network, or connect the drives by an adapter of their own"
            items.append(Finding("warn", "bus", f"{what}; allow_real_drive lets real drives be moved there", advice))
        else:
            items.append(Finding("info", "bus", f"{what}; only simulated drives are moved there"))
    return items


def judge_surroundings(config: BusConfig, spec: BusSpec, timer: Timer | None = None) -> list[Finding]:
    """Bus and clock of one bus; where the drives pace the bus (lockstep) no clock has to be kept."""
    items = judge_bus(config, spec)
    if config.pacing == "real":
        items.append(judge_lateness(measure_lateness(config.sync_period_s, timer), config.sync_period_s))
    return items
