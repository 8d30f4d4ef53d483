"""Stages of all seeds over PyBullet and CAN, kept as soon as they are done."""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.pair.bus_rows import run_stage


@dataclass(slots=True)
class BusTier:
    """Stages of all seeds over PyBullet and CAN: what is there already is not run again.

    Attributes
    ----------
    out : folder of the seeds' files
    seeds, stages : what to run; one seed after the other, so that an interrupted run has whole seeds
    frozen : cycles with learning off behind learning
    until_s : monotonic time after which no stage begins
    failed : stages that ended in an error
    """

    out: Path
    seeds: Sequence[int]
    stages: tuple[str, ...]
    frozen: int
    until_s: float
    failed: list[str] = field(default_factory=list)

    def run(self, jobs: int) -> None:
        """All stages that are missing, `jobs` at a time, each written as soon as it is done."""
        there = {seed: self._read(seed) for seed in self.seeds}
        left = [
            (stage, seed)
            for seed in self.seeds
            for stage in self.stages
            if stage not in (there[seed] or {"stages": ()})["stages"]
        ]
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=context, max_tasks_per_child=1) as pool:
            running: dict[Future[None], tuple[str, int]] = {}
            while running or (left and time.monotonic() < self.until_s):
                busy = {seed for _, seed in running.values()}
                ready = [item for item in left if item[1] not in busy] if time.monotonic() < self.until_s else []
                if ready and len(running) < jobs:
                    left.remove(ready[0])
                    running[pool.submit(run_and_keep, self.out, *ready[0], self.frozen)] = ready[0]
                    continue
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    self._ended(future, *running.pop(future))

    def _ended(self, future: Future[None], stage: str, seed: int) -> None:
        error = future.exception()
        if error is not None:
            self.failed.append(f"seed {seed}, {stage}: {type(error).__name__}: {error}")
        print(f"seed {seed}, {stage}: {'done' if error is None else self.failed[-1]}", flush=True)

    def _read(self, seed: int) -> dict[str, Any] | None:
        path = self.out / f"seed-{seed}.json"
        return json.loads(path.read_text()) if path.exists() else None

    def done(self) -> list[dict[str, Any]]:
        """What there is of each seed."""
        return [seen for seed in self.seeds if (seen := self._read(seed)) is not None]


def run_and_keep(out: Path, stage: str, seed: int, frozen: int) -> None:
    """A stage of a seed, its rows added to the seed's file."""
    path = out / f"seed-{seed}.json"
    try:
        seen = run_stage(seed, stage, frozen, json.loads(path.read_text()) if path.exists() else None)
    except Exception as error:  # errors that hold more than their text cannot be handed on between processes
        raise RuntimeError(f"{type(error).__name__}: {error}") from None
    part = path.with_suffix(".part")
    part.write_text(json.dumps(seen) + "\n")
    part.replace(path)
