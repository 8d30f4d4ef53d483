"""Recordings estimated anew: how it scales to two workers, what a killed worker costs, how flat the memory is."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
from click.testing import CliRunner

from benchmarks.figure import figure
from benchmarks.rigs.pacing import in_lockstep
from gateway.cli import main
from gateway.data.recording.seal import SEAL_BYTES, sealed
from gateway.fleet.analyse import AsOf, analyse
from gateway.fleet.columns import ESTIMATE
from gateway.fleet.ingest import ingest
from gateway.fleet.store import Store, open_or_make
from gateway.fleet.workers import workers
from sim.serve import running

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "small"
FIRST = datetime(2026, 1, 1, tzinfo=UTC)


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
                handle.hang(label)
            told = ["record", str(cell), "--load", label, "-o", str(run), "--bus", bus, "--yes", "-q", *more]
            done = CliRunner(env=environment).invoke(main, told)
            assert done.exit_code == 0, done.output
    return run


def many(base: Path, folder: Path, count: int) -> list[Path]:
    """Copies of a recording, a day apart and with other noise in their words."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in range(count):
        path = folder / f"run{number:05d}.h5"
        path.write_bytes(base.read_bytes()[:-SEAL_BYTES])
        with h5py.File(path, "r+") as file:
            file.attrs["created"] = (FIRST + timedelta(days=number)).isoformat()
        path.write_bytes(sealed(path.read_bytes()))
        paths.append(path)
    return paths


def store_of(paths: list[Path], place: Path) -> Store:
    """A store that holds them."""
    store = open_or_make(place)
    done = ingest(store, paths, FIRST + timedelta(days=4000))
    assert done.added == len(paths), done
    return store


def estimated(store: Store) -> int:
    """Recordings that are estimated, with numbers."""
    count = 0
    for robot in store.robots():
        rows = store.read(robot)
        kinds, bands = rows["kind"].to_pylist(), rows["friction_band_nm"].to_pylist()
        count += sum(kind == ESTIMATE and band is not None for kind, band in zip(kinds, bands, strict=True))
    return count


def scaling(folder: Path, count: int, rounds: int = 3) -> dict[str, dict]:
    """Recordings a second with two workers over twice those with one, in turns; the load of the machine beside it."""
    paths = many(recorded(folder / "base"), folder / "runs", count)
    ratios, loads, rates = [], [], []
    for turn in range(rounds):
        took = {}
        for size in (1, 2) if turn % 2 else (2, 1):
            store = store_of(paths, folder / f"store{turn}-{size}")
            with workers(None, size) as spread:
                list(spread(os.path.exists, [str(path) for path in paths[: 4 * size]]))
                started = time.perf_counter()
                found = analyse(store, spread, AsOf(FIRST))
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
        "recordings re-estimated": _printed(count),
        "recordings a second, 2 workers": _printed(float(np.median(rates)), "1/s"),
        "load of the machine meanwhile (processors: 2)": _printed(float(np.mean(loads))),
    }


def killed(folder: Path, count: int) -> dict[str, dict]:
    """Recordings that are missing after a worker was killed in the middle."""
    store = store_of(many(folder / "base" / "base.h5", folder / "runs", count), folder / "killed")
    victims = []

    def kill_one(what: str, done: int) -> None:
        if what == "recordings" and done == count // 4 and not victims:
            victims.append(_a_worker())
            os.kill(victims[0], signal.SIGKILL)

    with workers(None, 2) as spread:
        found = analyse(store, spread, AsOf(FIRST), kill_one)
    assert victims
    return {"recordings lost to a killed worker": figure(count - estimated(store) + len(found.failed), "== 0")}


def _a_worker() -> int:
    """Process number of a worker of this process."""
    import psutil

    processes = psutil.Process().children(recursive=True)
    return next(each.pid for each in processes if "spawn_main" in " ".join(each.cmdline()))


def memory(folder: Path, count: int) -> dict[str, dict]:
    """Largest resident memory of `fleet analyse` and of its workers, at some recordings and at four times as many."""
    runs = many(folder / "base" / "base.h5", folder / "runs", 4 * count)
    most = {}
    for size in (count, 4 * count):
        store = store_of(runs[:size], folder / f"memory{size}")
        most[size] = _most_mb(
            [sys.executable, "-m", "gateway.cli", "fleet", "analyse", str(store.path), "--workers", "1"]
        )
    return {
        "memory of fleet analyse, four times the recordings over as many": figure(
            most[4 * count] / most[count], "<= 1.1"
        ),
        f"memory of fleet analyse, {count} recordings": _printed(most[count], "MB"),
        f"memory of fleet analyse, {4 * count} recordings": _printed(most[4 * count], "MB"),
    }


def _most_mb(command: list[str]) -> float:
    """Largest memory [MB] of a program and what it starts, looked at every 0.1 s."""
    import psutil

    program = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    most, over = [0.0], threading.Event()

    def look() -> None:
        while not over.wait(0.1):
            total = 0
            with suppress(psutil.Error):
                itself = psutil.Process(program.pid)
                for each in (itself, *itself.children(recursive=True)):
                    with suppress(psutil.Error):
                        total += each.memory_info().rss
            most[0] = max(most[0], total / 1e6)

    watcher = threading.Thread(target=look)
    watcher.start()
    code = program.wait()
    over.set()
    watcher.join()
    assert code == 0, code
    return most[0]


def _printed(value: float, unit: str = "") -> dict:
    return {"value": value, "unit": unit, "goal": "printed", "met": None}
