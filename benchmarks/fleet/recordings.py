"""Recordings estimated again: how it scales to two workers, what a killed worker costs, how flat the memory is."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
from click.testing import CliRunner

from benchmarks.figure import figure
from gateway.cli import main
from gateway.data.recording.seal import SEAL_BYTES, sealed
from gateway.fleet.analysis import run_analysis
from gateway.fleet.checks import estimated_rows
from gateway.fleet.columns import ESTIMATE
from gateway.fleet.ingest import ingest
from gateway.fleet.store import Store, open_or_make
from gateway.fleet.workers import workers
from sim.serve import running
from tests.support.rigs.pacing import in_lockstep

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "small"
FIRST = datetime(2026, 1, 1, tzinfo=UTC)
#: Recordings of one robot, a day apart.
OF_A_ROBOT = 20
#: Recordings that one worker and two do in turns: enough to last longer than workers take to start.
SCALED = 60
ROUNDS = 3
#: How often the memory is looked at, and how often it is asked how far a run has come [s].
LOOK_S, ASK_S = 0.2, 2.0


def figures(folder: Path, count: int) -> dict[str, dict]:
    """Return all figures of recordings, of which so many are estimated again."""
    base = recorded(folder / "base")
    found = scaling(base, folder / "scaling", min(count, SCALED))
    return found | complete_fleet(base, folder / "whole", count)


def recorded(folder: Path) -> Path:
    """A recording of the small example arm, bare and loaded, by the simulator."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("robot.urdf", "payload.toml"):
        shutil.copy(EXAMPLE / name, folder / name)
    cell, run = folder / "cell.toml", folder / "base.h5"
    cell.write_text(in_lockstep((EXAMPLE / "cell.toml").read_text()))
    bus = f"virtual:fleet-{uuid.uuid4().hex}"
    environment = {"XDG_STATE_HOME": str(folder / "state")}
    with running(cell, bus, payload=folder / "payload.toml") as handle:
        for label, more in (("none", ()), ("load", ("--resume",))):
            if label != "none":
                handle.mount(label)
            command = ["record", str(cell), "--load", label, "-o", str(run), "--bus", bus, "--yes", "-q", *more]
            done = CliRunner(env=environment).invoke(main, command)
            assert done.exit_code == 0, done.output
    return run


def many(base: Path, folder: Path, numbers: range) -> list[Path]:
    """Copies of a recording under the names of many robots, a day apart."""
    folder.mkdir(parents=True, exist_ok=True)
    content = base.read_bytes()[:-SEAL_BYTES]
    paths = []
    for number in numbers:
        path = folder / f"run{number:05d}.h5"
        path.write_bytes(content)
        robot, day = divmod(number, OF_A_ROBOT)
        with h5py.File(path, "r+") as file:
            cell = str(file.attrs["cell"])
            file.attrs["cell"] = cell.replace('name = "small"', f'name = "small{robot:03d}"', 1)
            file.attrs["created"] = (FIRST + timedelta(days=day)).isoformat()
        path.write_bytes(sealed(path.read_bytes()))
        paths.append(path)
    return paths


def fill(store: Store, paths: list[Path]) -> None:
    """Ingest them, and take them away: the store has its copies."""
    done = ingest(store, paths, FIRST + timedelta(days=OF_A_ROBOT))
    assert done.added == len(paths), done
    for path in paths:
        path.unlink()


def estimated(store: Store) -> int:
    """Recordings that are estimated, with numbers."""
    count = 0
    for robot in store.robots():
        rows = store.read(robot)
        kinds, bands = rows["kind"].to_pylist(), rows["friction_band_nm"].to_pylist()
        count += sum(kind == ESTIMATE and band is not None for kind, band in zip(kinds, bands, strict=True))
    return count


def _warm(path: str) -> int:
    """What a worker does once before the time is taken: it loads what an estimate needs."""
    return len(estimated_rows(Path(path), "", FIRST))


def scaling(base: Path, folder: Path, count: int) -> dict[str, dict]:
    """Recordings a second with two workers over twice those with one, in turns; the load of the machine beside it."""
    kept = open_or_make(folder / "store")
    fill(kept, many(base, folder / "runs", range(count)))
    ratios, loads, rates = [], [], []
    for turn in range(ROUNDS):
        took = {}
        for size in (1, 2) if turn % 2 else (2, 1):
            store = Store(Path(shutil.copytree(kept.path, folder / f"store{turn}-{size}")))
            with workers(None, size) as spread:
                list(spread(_warm, [str(base)] * (4 * size)))
                started = time.perf_counter()
                found = run_analysis(store, spread, FIRST)
                took[size] = time.perf_counter() - started
            assert not found.failed, found.failed
            assert estimated(store) == count
            shutil.rmtree(store.path)
        loads.append(os.getloadavg()[0])
        ratios.append(took[1] / took[2] / 2.0)
        rates.append(count / took[2])
    return {
        "re-estimation, 1 to 2 workers, share of linear": figure(float(np.median(ratios)), ">= 0.85")
        | {"interval": [min(ratios), max(ratios)]},
        "recordings of the comparison": figure(count),
        "recordings a second, 2 workers": figure(float(np.median(rates)), unit="1/s"),
        "load of the machine meanwhile (processors: 2)": figure(float(np.mean(loads))),
    }


def complete_fleet(base: Path, folder: Path, count: int) -> dict[str, dict]:
    """`fleet analyse` of a quarter of the recordings, and of all of them while a worker is killed in the middle."""
    few = max(count // 4, 1)
    store = open_or_make(folder / "store")
    fill(store, many(base, folder / "runs", range(few)))
    quarter = Store(Path(shutil.copytree(store.path, folder / "quarter")))
    least_mb, _ = _analysed(quarter, lambda _: None)
    assert estimated(quarter) == few
    shutil.rmtree(quarter.path)
    fill(store, many(base, folder / "runs", range(few, count)))
    victims: list[int] = []

    def kill_one(program: int) -> None:
        if not victims and estimated(store) >= few:
            victims.append(_a_worker(program))
            os.kill(victims[0], signal.SIGKILL)

    most_mb, took_s = _analysed(store, kill_one)
    assert victims, "no worker was killed: with fewer than 100 recordings the run is over before"
    return {
        "recordings re-estimated": figure(count),
        "recordings lost to a killed worker": figure(count - estimated(store), "== 0"),
        "time of fleet analyse, 2 workers, one killed": figure(took_s, unit="s"),
        "memory of fleet analyse, all recordings over a quarter of them": figure(most_mb / least_mb, "<= 1.1"),
        f"memory of fleet analyse and its workers, {few} recordings": figure(least_mb, unit="MB"),
        f"memory of fleet analyse and its workers, {count} recordings": figure(most_mb, unit="MB"),
    }


def _a_worker(program: int) -> int:
    """Process number of a worker of a program."""
    import psutil

    processes = psutil.Process(program).children(recursive=True)
    return next(each.pid for each in processes if "spawn_main" in " ".join(each.cmdline()))


def _analysed(store: Store, asked: Callable[[int], None]) -> tuple[float, float]:
    """Largest memory [MB] of `fleet analyse` with its workers and these, and how long it took [s].

    `asked` receives its process id every two seconds.
    """
    command = store.path.with_suffix(".json")
    words = ["fleet", "analyse", str(store.path), "--json", str(command)]
    started = time.perf_counter()
    program = subprocess.Popen([sys.executable, "-m", "gateway.cli", *words], stdout=subprocess.DEVNULL)
    most_mb, next_s = 0.0, ASK_S
    while program.poll() is None:
        most_mb = max(most_mb, _memory_mb(program.pid))
        if time.perf_counter() - started > next_s:
            asked(program.pid)
            next_s = time.perf_counter() - started + ASK_S
        time.sleep(LOOK_S)
    took_s = time.perf_counter() - started
    assert program.returncode == 0, program.returncode
    assert json.loads(command.read_text())["failed"] == []
    return most_mb, took_s


def _memory_mb(program: int) -> float:
    """Resident memory of a program and of all that it started."""
    import psutil

    total = 0
    with suppress(psutil.Error):
        itself = psutil.Process(program)
        for each in (itself, *itself.children(recursive=True)):
            with suppress(psutil.Error):
                total += each.memory_info().rss
    return total / 1e6
