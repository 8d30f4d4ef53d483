"""What the page costs and whether it is in time: seen, stopped, left alone and mistreated."""

from __future__ import annotations

import os
import shutil
import struct
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path

import can
import numpy as np
from scipy import stats

from benchmarks.chaos.processes import undisturbed
from benchmarks.figure import figure
from benchmarks.live.rig import (
    Counted,
    cell_in,
    counted,
    drives,
    frames_of,
    processor_s,
    recording,
    running,
    viewers,
    wait_for,
)
from tests.support.pages.browser import Browser, browser

Figures = dict[str, dict]

WIDE, NARROW = (1280, 900), (390, 844)
#: Controlword bits (CiA 402-2, table of the controlword): quick stop is active low, and comes with enable voltage.
RPDO1, ENABLED, QUICK_STOP_MASK, QUICK_STOP = 0x201, 0x0F, 0x06, 0x02
#: Share of the speed before, below which a setpoint counts as one that brakes.
BRAKES = 0.9
#: SYNCs over which that speed is taken, and the slowest one at which a click is judged, counts per SYNC.
BEFORE, LEAST_COUNTS = 12, 200.0
PAGES = 50
#: Pairs of runs that are tried on a computer that is stalled, until one pair is whole.
MOST_TURNS = 5
#: Postures between which the arm goes to and fro: joint angles [rad].
TARGETS = ("-2,-0.2,0.4,0,0.3,0", "2,-0.2,0.4,0,0.3,0")


@contextmanager
def looking(alone: bool) -> Iterator[Browser]:
    """A browser; `alone`: as if this computer did nothing else, where a real-time scheduler is permitted."""
    with ExitStack() as stack:
        with undisturbed() if alone else nullcontext():
            window = stack.enter_context(browser())
        yield window


def prefer(pid: int) -> None:
    """The same for a process that runs already."""
    with suppress(OSError):
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(1))


def seen(out: Path, seconds: float, *, alone: bool) -> Figures:
    """Frames a second, sample to screen, processor time of the page; and pictures."""
    cell = cell_in(out / "seen", "real", 6)
    with recording(out / "seen", cell, "--live") as command, looking(alone) as window:
        window.resize(*WIDE)
        window.visit(command.address())
        command.moving()
        pid = command.page_pid()
        if alone:
            prefer(pid)
        window.run("live.lag_ms.length = 0; live.cost_ms.length = 0; live.began = [performance.now(), live.frames]")
        before_s, began_s, share = processor_s(pid), time.monotonic(), 0.0
        while time.monotonic() - began_s < seconds and command.process.poll() is None:
            time.sleep(1.0)
            with suppress(OSError):  # it leaves with its command
                share = (processor_s(pid) - before_s) / (time.monotonic() - began_s)
        rate = window.run("return (live.frames - live.began[1]) / (performance.now() - live.began[0]) * 1e3")
        lag_ms, cost_ms = window.run("return [live.lag_ms, live.cost_ms]")
        print(command.text[-300:] if command.process.poll() is not None else "", file=sys.stderr)
        pictures(window, out)
    return {
        "frames a second of the page": figure(round(rate, 1), ">= 20", "1/s"),
        "sample to screen, p95": figure(round(float(np.percentile(lag_ms, 95)), 1), "<= 150", "ms"),
        "processor of the page's process": figure(round(100.0 * share, 1), "<= 20", "% of a core"),
        "drawing one frame in the browser, median": {"value": round(float(np.median(cost_ms)), 1), "unit": "ms"},
    }


def pictures(window: Browser, out: Path) -> None:
    """The page as it is, wide and narrow, light and dark."""
    for scheme in ("light", "dark"):
        window.in_light(scheme)
        for name, size in (("wide", WIDE), ("narrow", NARROW)):
            window.resize(*size)
            time.sleep(0.5)
            window.picture(out / f"{scheme}-{name}.png")
        window.resize(*WIDE)


def paired(out: Path, minutes: float) -> Figures:
    """Runs in real time with and without the page in a browser, in turn: SYNCs that were not answered whole."""
    folder = out / "paired"
    _by_the_clock(folder, shown=False)  # the first one proves the stop of the drives: it is longer than all others
    both: list[tuple[Counted, Counted]] = []
    stops = [0, 0]
    until_s = time.monotonic() + 60.0 * minutes
    turn = 0
    while time.monotonic() < until_s or (not both and turn < MOST_TURNS):
        counts: dict[bool, Counted | None] = {}
        for shown in (False, True) if turn % 2 else (True, False):
            counts[shown] = _by_the_clock(folder, shown=shown)
            stops[shown] += counts[shown] is None
        without, with_it = counts[False], counts[True]
        if without is not None and with_it is not None:
            both.append((without, with_it))
        turn += 1
    more = [with_it.per_10_min - without.per_10_min for without, with_it in both]
    figures: Figures = {"incomplete epochs that it causes in 10 min": _caused(more)}
    for name, which in (("without it", 0), ("with it in a browser", 1)):
        syncs, lost = (sum(getattr(each[which], what) for each in both) for what in ("syncs", "incomplete"))
        figures[f"incomplete epochs {name}"] = {"value": lost, "unit": f"of {syncs} SYNCs, {len(both)} runs"}
    return figures | {
        "runs that were stopped, without and with it": {"value": sum(stops), "unit": f"{stops[0]} and {stops[1]}"}
    }


def _by_the_clock(folder: Path, *, shown: bool) -> Counted | None:
    """One run; None where it was stopped, as by a computer that is stalled."""
    cell, report = cell_in(folder, "real", 3), folder / "run.json"
    report.unlink(missing_ok=True)
    more = ["--json", str(report), *(["--live"] if shown else [])]
    with recording(folder, cell, *more) as command, ExitStack() as stack:
        if shown:
            window = stack.enter_context(browser())
            window.resize(*WIDE)
            window.visit(command.address())
        command.process.wait(300.0)
        if command.process.returncode or not report.exists():
            print(command.text[-300:], file=sys.stderr)
            return None
    return counted(report)


def _caused(more: Sequence[float]) -> dict:
    """Mean over pairs of runs, with its 95 % interval by Student's t where there are several."""
    if not more:
        return figure(float("nan"), "<= 0")
    mean, interval = float(np.mean(more)), None
    if len(more) > 1:
        half = float(stats.t.ppf(0.975, len(more) - 1) * np.std(more, ddof=1) / np.sqrt(len(more)))
        interval = (round(mean - half, 1), round(mean + half, 1))
    return figure(round(mean, 1), "<= 0", "", interval)


def stopped(out: Path, clicks: int, *, alone: bool) -> Figures:
    """Click to the first setpoint that brakes, and second click to the quick stop word, on the bus."""
    slow_ms, word_ms = [], []
    folder = out / "stopped"
    cell = cell_in(folder, "real", 2)
    with drives(folder, cell) as bus, looking(alone) as window:
        for number in range(clicks):
            wanted = ("move", str(cell), "--bus", bus, "--to", TARGETS[number % 2], "--yes", "--override", "100")
            with running(folder, *wanted, "--live") as command, frames_of(bus) as received:
                window.visit(command.address())
                if alone:
                    prefer(command.page_pid())
                wait_for(lambda: window.run(FAST) or command.process.poll() is not None)
                window.run(CLICK_TWICE)
                command.process.wait(60.0)
                clicked_ms = window.run("return live.clicked")
            rows = commands(received)
            braked, quick = brakes_at(rows, clicked_ms[0] / 1e3), quick_stop_at(rows, clicked_ms[0] / 1e3)
            slow_ms += [] if braked is None else [1e3 * braked - clicked_ms[0]]
            word_ms += [] if quick is None or len(clicked_ms) < 2 else [1e3 * quick - clicked_ms[1]]
    return {
        "stop clicked twice to the quick stop word on the bus, p95": figure(
            round(float(np.percentile(word_ms, 95)), 1) if word_ms else float("nan"), "<= 200", "ms"
        ),
        "stop clicked to the first setpoint that brakes, p95": figure(
            round(float(np.percentile(slow_ms, 95)), 1) if slow_ms else float("nan"), "<= 200", "ms"
        ),
        "clicks": {"value": clicks, "unit": f"judged {len(slow_ms)} and {len(word_ms)}"},
    }


#: Some joint turns fast and evenly.
FAST = """
const arm = live.arms[0], last = arm ? arm.time.length - 1 : 0;
if (byId("phase").textContent !== "moving" || last < 30) return false;
return arm.values[1].some((joint) => {
  const now = Math.abs(joint[last]), before = Math.abs(joint[last - 15]);
  return now > 0.12 && Math.abs(now - before) < 0.03 * now;
});
"""
CLICK_TWICE = """
const button = document.getElementById("stop");
live.clicked = [Date.now()];
button.click();
setTimeout(() => { live.clicked.push(Date.now()); button.click(); }, 60);
"""


def commands(frames: Iterable[can.Message]) -> list[tuple[float, int, int]]:
    """When [s, wall clock], controlword and target of the node with the longest motion, frame by frame."""
    by_node: dict[int, list[tuple[float, int, int]]] = {}
    for frame in frames:
        if RPDO1 <= frame.arbitration_id < RPDO1 + 6 and len(frame.data) == 6:
            word, target = struct.unpack("<Hi", frame.data)
            by_node.setdefault(frame.arbitration_id, []).append((frame.timestamp, word, target))
    return max(by_node.values(), key=lambda rows: float(np.ptp([target for _, _, target in rows])))


def brakes_at(rows: Sequence[tuple[float, int, int]], clicked_s: float) -> float | None:
    """When the first setpoint after a click goes less far than those before it."""
    times, targets = np.array([row[0] for row in rows]), np.array([row[2] for row in rows], dtype=float)
    steps = np.abs(np.diff(targets))
    start = int(np.searchsorted(times, clicked_s))
    before = float(np.median(steps[max(start - BEFORE, 0) : start])) if start > BEFORE else 0.0
    if before < LEAST_COUNTS:
        return None
    slower = np.nonzero(steps[start:] < BRAKES * before)[0]
    return None if not len(slower) else float(times[start + slower[0] + 1])


def quick_stop_at(rows: Sequence[tuple[float, int, int]], clicked_s: float) -> float | None:
    """When the first controlword after a click asks for a quick stop."""
    for time_s, word, _ in rows:
        if time_s > clicked_s and word & QUICK_STOP_MASK == QUICK_STOP:
            return time_s
    return None


def mistreated(out: Path) -> Figures:
    """In lockstep, where a run is the same every time: setpoints with the page opened 50 times or not read."""
    plain = _set_points(out / "plain", 0)
    figures: Figures = {}
    for name, count, read in (("a browser that reads nothing", 1, False), (f"{PAGES} pages open", PAGES, True)):
        other = _set_points(out / "mistreated", count, read=read)
        differ = abs(len(other) - len(plain)) + sum(a != b for a, b in zip(other, plain, strict=False))
        figures[f"{name}: setpoints that differ"] = figure(differ, "== 0", f"of {len(plain)}")
    return figures


def _set_points(folder: Path, pages: int, *, read: bool = True) -> list[tuple[int, int]]:
    """Controlword and target of an axis, SYNC by SYNC, of a whole run, with so many open pages."""
    shutil.rmtree(folder, ignore_errors=True)
    cell, trace = cell_in(folder, "lockstep", 2), folder / "frames.log"
    more = ["--live"] if pages else []
    with recording(folder, cell, "--trace", str(trace), *more) as command, ExitStack() as stack:
        if pages:
            stack.enter_context(viewers(command.address(), pages, read=read))
        command.process.wait(300.0)
        if command.process.returncode:
            raise RuntimeError(f"{folder.name}: {command.text[-500:]}")
    with can.LogReader(str(trace)) as frames:
        return [(word, target) for _, word, target in commands(frames)]
