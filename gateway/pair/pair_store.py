"""Files of a pair beside its cell file: points, functions, learning state, runs for the report.

CELL.pair/points.json    taught points, so that teaching can be resumed
CELL.pair/first.json     function through the taught points
CELL.pair/second.json    function learned on the run
CELL.pair/back.json      the same of the return
CELL.pair/speed-X.json   the last one of each speed setting
CELL.pair/state.json     learning on or off
CELL.pair/run-NAME.json  cycles of the last run of an embodiment
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drives.files import replace_file
from gateway.errors import InputError
from gateway.pair.pair_cell import PairCell
from gateway.pair.pair_run import PairCycle, PairRun
from gateway.pair.path import PairPath
from gateway.pair.transform import Floats
from gateway.pair.transform_function import TransformFunction, read_stored, refuse_foreign, stored_function
from gateway.result.numerals import TWO_SIDED_95
from gateway.result.pair import LearningSwitch, LinkStatistics, PairRunResult, Stage, StoredFunction
from gateway.result.values import Model, Numbers, decoded, json_object, json_text, numbers, plain_values, text_of

HASH_DECIMALS = 7


def cell_hash(cell: PairCell) -> str:
    """SHA-256 of what a function depends on beside the path: bases, arms, grips, zero positions, distance sensors."""
    digest = hashlib.sha256()
    for arm in cell.arms:
        axes = [[axis.zero_offset_rad, axis.gear_ratio.value, axis.position_sign] for axis in arm.config.axis]
        for value in (arm.world_from_base, arm.part_from_tip, arm.chain.fixed, arm.chain.step_m, arm.chain.tool, axes):
            digest.update(np.ascontiguousarray(np.round(value, HASH_DECIMALS) + 0.0, dtype="<f8").tobytes())
    if cell.gap is not None:
        digest.update(cell.gap.config.model_dump_json(include={"components", "channel"}).encode())
    return digest.hexdigest()


class PairStore:
    """Files of one pair.

    Parameters
    ----------
    cell : PairCell
    folder : Path
    """

    def __init__(self, cell: PairCell, folder: Path) -> None:
        self.folder = folder
        self.path_hash, self.cell_hash = cell.program.hash, cell_hash(cell)
        self.points = folder / "points.json"

    def save(self, stage: Stage, function: TransformFunction, **origin: Any) -> Path:
        """Store a function; `origin` are the fields of `StoredFunction` that are not known here."""
        stored = stored_function(
            function,
            path_hash=self.path_hash,
            cell_hash=self.cell_hash,
            stage=stage,
            date=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            **origin,
        )
        return self.write(f"{stage}.json", json_text(stored))

    def load(self, stage: Stage) -> StoredFunction | None:
        """A stored function, None where there is none.

        Raises
        ------
        InputError
            It is for another path or another cell, or damaged.
        """
        path = self.folder / f"{stage}.json"
        if not path.exists():
            return None
        stored = read_stored(path)
        refuse_foreign(stored, self.path_hash, self.cell_hash, str(path))
        return stored

    def write(self, name: str, text: str) -> Path:
        """Write a file whole."""
        path = self.folder / name
        replace_file(path, text)
        return path

    @property
    def frozen(self) -> bool:
        """Learning is switched off."""
        path = self.folder / "state.json"
        return path.exists() and _read(LearningSwitch, path).frozen

    def freeze(self, frozen: bool) -> None:
        """Switch learning off or on."""
        self.write("state.json", json_text(LearningSwitch(frozen)))

    def forget(self) -> bool:
        """Delete what was learned on the run and switch learning on; whether there was anything."""
        learned = [self.folder / f"{stage}.json" for stage in ("second", "back")]
        there = any(path.exists() for path in learned)
        for path in learned:
            path.unlink(missing_ok=True)
        (self.folder / "state.json").unlink(missing_ok=True)
        return there

    def keep(self, run: PairRunResult) -> None:
        """Keep a run for the report."""
        self.write(f"run-{run.name}.json", json.dumps(plain_values(run), allow_nan=False) + "\n")

    def run_files(self) -> list[Path]:
        """Files of the stored runs, in the order of their names."""
        return sorted(self.folder.glob("run-*.json"))

    def runs(self) -> list[PairRunResult]:
        """Stored runs with at least one cycle, for the report.

        Raises
        ------
        InputError
            One of them is damaged.
        """
        found = [_read(PairRunResult, path) for path in self.run_files()]
        return [run for run in found if run.cycles]


def _read(model: type[Model], path: Path) -> Model:
    try:
        return decoded(model, json_object(text_of(path, ""), str(path)), str(path))
    except InputError as error:
        raise InputError(f"{error}; is not what this program writes, delete it") from error


def line_of_grippers(cell: PairCell, path: PairPath) -> Floats:
    """Unit direction (M, 3) from gripper 1 to gripper 2 in the world."""
    first, second = cell.arms
    one = (first.world_from_base @ path.commands)[:, :3, 3]
    two = (second.world_from_base @ cell.nominal_slave(path))[:, :3, 3]
    return (two - one) / np.linalg.norm(two - one, axis=1, keepdims=True)


def run_result(cell: PairCell, run: PairRun, cycles: Sequence[PairCycle], statistics: LinkStatistics) -> PairRunResult:
    """At least one cycle of a run as the report takes them."""
    path = run.path
    drawn = _forces(cell, path, cycles) if cell.gap is None else _gaps(cycles)
    return PairRunResult(
        name=run.config.name,
        text=run.config.text,
        speed=path.speed,
        s_m=numbers(path.s_m),
        x_m=numbers((cell.arms[0].world_from_base @ path.commands)[:, 0, 3]),
        **drawn,
        knots_s_m=numbers(np.round(run.controller.function.s_m, 6)),
        cycles=tuple(cycle.summary for cycle in cycles),
        statistics=statistics,
        learning_s=max(cycle.learning_s for cycle in cycles),
        evaluation_s=float(np.mean([cycle.evaluation_s for cycle in cycles])),
    )


def _forces(cell: PairCell, path: PairPath, cycles: Sequence[PairCycle]) -> dict[str, Numbers]:
    """Force in the first and the last cycle [N]: along the line between the grippers, and its whole size."""
    along = line_of_grippers(cell, path)
    drawn: dict[str, Numbers] = {}
    for name, cycle in (("first", cycles[0]), ("last", cycles[-1])):
        force = cycle.force[:, :3]
        drawn[f"{name}_n"] = numbers(np.round(np.sum(force * along, axis=1), 2))
        drawn[f"{name}_size_n"] = numbers(np.round(np.linalg.norm(force, axis=1), 2))
        if cycle.internal_force is not None:
            drawn[f"{name}_half_n"] = numbers(np.round(TWO_SIDED_95 * cycle.internal_force.size_std_n, 2))
    return drawn


def _gaps(cycles: Sequence[PairCycle]) -> dict[str, Numbers]:
    """The distance that is furthest off the demanded one, by how much, in the first and the last cycle [m]."""
    first, last = ([max(row, key=abs) for row in cycle.gaps_m.tolist()] for cycle in (cycles[0], cycles[-1]))
    return {"first_m": numbers(np.round(first, 7)), "last_m": numbers(np.round(last, 7))}
