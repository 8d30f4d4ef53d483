"""Kills: the master by SIGKILL, its disk full, the drives' power; no finished visit is lost, and the drives stop."""

from __future__ import annotations

import os
import random
import re
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.chaos.processes import POSES, Drives, Job, Master, drives, restore
from benchmarks.chaos.rig import with_real_pacing
from gateway.data.recording.reader import read
from gateway.errors import InputError
from sim.faults import fault_of

#: Longest wait for a recording that is not killed.
WHOLE_S = 60.0
#: Share of the kills that meet a master which is still bringing the drives up.
STARTING_SHARE = 0.15
#: What the parent's look at the drives may add to their time [s].
LOOK_S = 0.02


def few_samples(text: str) -> str:
    """Edit of a cell's text: short visits, few SYNCs a second."""
    return re.sub(r"sync_period_s = [\d.]+", "sync_period_s = 0.02", re.sub(r"samples = \d+", "samples = 10", text))


@dataclass(slots=True)
class Losses:
    """What came of many interrupted recordings."""

    interrupted: int = 0
    announced: int = 0
    lost: int = 0
    unreadable: int = 0
    not_restored: int = 0
    restored: int = 0
    finished: int = 0
    complaints: list[str] = field(default_factory=list)


def visits_on_disk(path: Path) -> set[tuple[int, int]]:
    """(pose, side) of every finished visit; empty when there is no file."""
    if not path.exists():
        return set()
    return {(visit.pose, visit.approach) for arm in read(path).arms for visit in arm.visits if visit.complete}


def finished_on_disk(path: Path) -> set[tuple[int, int] | tuple[str, int]]:
    """(pose, side) of every finished visit and (motion, number) of every period; empty when there is no file."""
    if not path.exists():
        return set()
    return visits_on_disk(path) | {(each.name, each.period) for arm in read(path).arms for each in arm.periods}


def interrupt_recordings(kills: int, how: str, seed: int = 1) -> Losses:
    """Interrupt recordings at random instants and go on with them, again and again.

    Parameters
    ----------
    kills : int
        How many interruptions.
    how : str
        "sigkill", "disk full" or "power cycle".
    seed : int
        Of the instants.
    """
    losses = Losses()
    rng = random.Random(f"{how} {seed}")
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        folder = Path(name)
        with drives(folder, few_samples) as served:
            before = served.ask("values")
            promised: set[tuple[int, int]] = set()
            number = 0
            while losses.interrupted < kills:
                job = Job(folder, served.bus, folder / f"run-{number}.h5", _limit(how, rng))
                master = _interrupted(how, rng, job, served)
                ended = master.end == "done"
                losses.interrupted += not ended
                losses.announced += len(master.announced)
                promised |= set(master.announced)
                _look_at_file(job, promised, losses)
                if master.end.startswith("DEFECT"):
                    losses.complaints.append(master.end)
                if how == "sigkill" and rng.random() < 0.1:
                    _restore_all(job, served, before, losses)
                job.ledger.unlink(missing_ok=True)
                served.ask("renew")
                if ended or len(promised) == 2 * POSES or (how == "disk full" and rng.random() < 0.3):
                    losses.finished += ended
                    promised = set()
                    number += 1
    return losses


def _limit(how: str, rng: random.Random) -> int:
    return rng.randint(20_000, 250_000) if how == "disk full" else 0


def _interrupted(how: str, rng: random.Random, job: Job, served: Drives) -> Master:
    master = Master(job)
    if how == "sigkill":
        if rng.random() < STARTING_SHARE:
            master.listen(time.monotonic() + rng.uniform(0.0, 0.5))
        else:
            _until_moving(master)
            master.listen(time.monotonic() + rng.uniform(0.0, 2.5))
        master.kill()
        return master
    if how == "power cycle":
        _until_moving(master)
        served.ask("arm", fault_of("power_cycle", node=rng.randint(1, 6)), rng.randint(1, 800))
    master.wait(WHOLE_S)
    return master


def _until_moving(master: Master) -> None:
    until_s = time.monotonic() + WHOLE_S
    while not master.moving and not master.end and time.monotonic() < until_s:
        master.listen(time.monotonic() + 0.05)


def _look_at_file(job: Job, promised: set[tuple[int, int]], losses: Losses) -> None:
    try:
        kept = visits_on_disk(job.path)
    except InputError as error:
        losses.unreadable += 1
        losses.complaints.append(str(error))
        return
    missing = promised - kept
    losses.lost += len(missing)
    if missing:
        losses.complaints.append(f"{job.path.name}: {sorted(missing)} were announced and are not in the file")


def _restore_all(job: Job, served: Drives, before: list[dict], losses: Losses) -> None:
    served.ask("power off")
    if not job.ledger.exists():
        return
    answer = restore(job)
    left = [
        (node, address)
        for node, (old, new) in enumerate(zip(before, served.ask("values"), strict=True), start=1)
        for address, value in old.items()
        if new[address] != value
    ]
    losses.restored += 1
    if answer != "done" or left:
        losses.not_restored += 1
        losses.complaints.append(f"restore: {answer}; {left[:5]}")


# ------------------------------------------------------------------------------------------------- the master is gone


@dataclass(slots=True)
class Stops:
    """How long the drives went on without their master, from the kill to the last axis that is not enabled [s]."""

    times_s: list[float] = field(default_factory=list)
    bound_s: float = 0.0
    failed: int = 0
    complaints: list[str] = field(default_factory=list)


def drives_without_master(
    kills: int, how: str, seed: int = 1, progress: Callable[[], None] = lambda: None, period_s: float = 0.02
) -> Stops:
    """Take the master away while the arm moves, in real time, and watch the drives.

    Parameters
    ----------
    how : str
        "sigkill"; "sigstop": the master is stopped for a while and then goes on; "full queue": nothing it sends
        leaves the adapter any more.
    """
    stops = Stops()
    rng = random.Random(f"{how} {seed}")
    real = with_real_pacing(period_s)
    with tempfile.TemporaryDirectory(prefix="stops-") as name:
        folder = Path(name)
        with drives(folder, lambda text: real(few_samples(text))) as served:
            consumer_ms = re.search(r"consumer_ms = (\d+)", (folder / "drive.toml").read_text())
            stops.bound_s = int(consumer_ms.group(1)) * 1e-3 + period_s if consumer_ms else 0.0
            for number in range(kills):
                frames = rng.randint(300, 900) if how == "full queue" else 0
                job = Job(folder, served.bus, folder / f"run-{number}.h5", frames=frames)
                master = Master(job)
                until_s = time.monotonic() + 20.0
                while not served.enabled() and time.monotonic() < until_s and not master.end:
                    master.listen(time.monotonic() + 0.05)
                if how == "full queue":
                    _until_full(master)
                else:
                    master.listen(time.monotonic() + rng.uniform(0.2, 1.5))
                stops.times_s.append(_time_to_stop(how, master, served, stops))
                job.ledger.unlink(missing_ok=True)
                served.ask("renew")
                progress()
    return stops


def _until_full(master: Master) -> None:
    until_s = time.monotonic() + WHOLE_S
    while master.full_s is None and not master.end and time.monotonic() < until_s:
        master.listen(time.monotonic() + 0.002)


def _time_to_stop(how: str, master: Master, served: Drives, stops: Stops) -> float:
    if master.end or not served.enabled():
        stops.failed += 1
        stops.complaints.append(f"the run ended before the kill: {master.end}")
    pid = master.process.pid or 0
    if how != "full queue":
        os.kill(pid, signal.SIGKILL if how == "sigkill" else signal.SIGSTOP)
    gone_s = master.full_s or time.monotonic()
    while served.enabled() and time.monotonic() - gone_s < 5.0:
        time.sleep(LOOK_S / 4)
    took_s = time.monotonic() - gone_s
    if took_s > stops.bound_s + LOOK_S:
        stops.failed += 1
        stops.complaints.append(f"the drives went on for {took_s:.3f} s, {stops.bound_s:.3f} s are stated")
    if how != "sigkill":
        time.sleep(max(0.0, gone_s + 1.5 - time.monotonic()))
        if how == "sigstop":
            os.kill(pid, signal.SIGCONT)
        until_s = time.monotonic() + WHOLE_S
        while not master.end and time.monotonic() < until_s:
            master.listen(until_s)
        if not master.end.startswith("error"):
            stops.failed += 1
            stops.complaints.append(f"the master went on: {master.end or 'no end'}")
        if served.enabled():
            stops.failed += 1
            stops.complaints.append("the master enabled the drives again")
    master.kill()
    return took_s
