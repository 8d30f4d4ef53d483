"""Check the computer and its bus: accuracy of the SYNC period, and other writers on the bus."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from drives.bus import BusSpec
from drives.bus_spec import NETWORKS
from drives.realtime import RealTimeStatus
from gateway.cell.config import BusConfig
from gateway.result.result import Finding

#: Duration of the timer measurement [s], and allowed delay (99 %) as a share of the period.
MEASURE_S: Final = 0.3
DELAY_SHARE: Final = 0.5


def measure_lateness(
    period_s: float, now: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
) -> list[float]:
    """Measure the delay of a timer loop without work, per period.

    Parameters
    ----------
    period_s : float
    now, sleep : callables, optional
        Monotonic time [s], and wait function.

    Returns
    -------
    list of float
        One per period [s].
    """
    start = now()
    delays: list[float] = []
    for number in range(1, max(2, round(MEASURE_S / period_s)) + 1):
        due = start + number * period_s
        while (left := due - now()) > 0.0:
            sleep(left)
        delays.append(now() - due)
    return delays


def judge_lateness(delay_s: Sequence[float], period_s: float) -> Finding:
    """Check whether this computer keeps the SYNC period.

    Parameters
    ----------
    delay_s : sequence of float
        As `measure_lateness` gives it.
    period_s : float
    """
    p99_s = float(np.percentile(delay_s, 99))
    what = (
        f"timer delay of this computer at {1000 * period_s:g} ms period: up to {1000 * p99_s:.2g} ms (99 % of "
        f"{len(delay_s)}"
        " cycles)"
    )
    if p99_s > DELAY_SHARE * period_s:
        return Finding("fail", "computer", what, "raise sync_period_s or stop other programs")
    return Finding("ok", "computer", what)


def judge_realtime(status: RealTimeStatus) -> Finding:
    """Check permission for real-time priority and locked memory."""
    if status.fifo and status.locked:
        return Finding("ok", "computer", "real-time scheduling (SCHED_FIFO) and locked memory are allowed")
    advice = "permit both; otherwise other programs may delay the SYNC"
    return Finding("info", "computer", status.why, advice)


def judge_bus(config: BusConfig, spec: BusSpec) -> list[Finding]:
    """Check the source of frame times, and who can write to this bus.

    Parameters
    ----------
    config : BusConfig
        Of the cell.
    spec : BusSpec
        The bus that is used.
    """
    if spec.interface == "socketcan":
        return [Finding("ok", "bus", "frame times from the kernel")]
    items = [Finding("info", "bus", f"{spec.interface}: frame times from its driver, not from the kernel")]
    if spec.interface in NETWORKS:
        what = f"{spec} is a network: every host on it can send frames, including controlwords"
        if config.allow_real_drive:
            advice = "use a separate network, or connect the drives through a CAN adapter"
            items.append(Finding("warn", "bus", f"{what}; real drives are allowed by allow_real_drive", advice))
        else:
            items.append(Finding("info", "bus", f"{what}; only simulated drives are allowed"))
    return items


def judge_surroundings(
    config: BusConfig,
    spec: BusSpec,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> list[Finding]:
    """Check access and clock of one bus; in lockstep the clock is not checked."""
    items = judge_bus(config, spec)
    if config.pacing == "real":
        items.append(judge_lateness(measure_lateness(config.sync_period_s, now, sleep), config.sync_period_s))
    return items
