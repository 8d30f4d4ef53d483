"""One cell of nature from start to end: measured, estimated, diagnosed, held against what is there."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.oracle import load_std, log_likelihood_ratios
from benchmarks.nature.effect import rows_of
from benchmarks.nature.measuring import OutlierVisit
from benchmarks.nature.nature_cell import VISIT_S, NatureCell, draw_cell, draw_effect_cell
from benchmarks.nature.strength import strengths_beside
from gateway.data.table import Table
from gateway.diagnose import close_loop, diagnose
from gateway.errors import GatewayError
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import LoadEstimate
from gateway.model.robot import robot_from_urdf
from gateway.result.result import LoadResult, Result
from sim.offline import PlannedVisit
from tests.support.rigs.tables import simulated_table

Floats = NDArray[np.float64]

VALIDATION, TIMED_POSES = 4, 40
#: Half width of a 95 % interval, in standard deviations.
HALF_WIDTH = 1.96


@dataclass(frozen=True, slots=True)
class Intervals:
    """Of mass, x, y, z: whether the 95 % interval holds the truth, its width over the oracle's; NaN where not given."""

    inside: list[float]
    width: list[float]


@dataclass(frozen=True, slots=True)
class Score:
    """What is kept of one cell.

    `truth` is mechanism, joints, strength; `beside` the strengths beyond what other effects could take over; `outliers`
    is pose, load, joint, bands. `formula` are the products of a candidate formula, `formula_left` what it leaves of
    poses outside its choice, over the noise floor. `log_ratios` are the log likelihood ratios of the oracle for each
    effect.
    """

    seed: int
    condition: str
    kind: str
    misstated: bool
    truth: list
    beside: list
    visits: list
    outliers: list
    estimated: Intervals | None = None
    diagnosed: Intervals | None = None
    found: list = field(default_factory=list)
    verdict: str = ""
    set_aside: list = field(default_factory=list)
    formula: list = field(default_factory=list)
    formula_left: float = float("nan")
    log_ratios: list = field(default_factory=list)
    refused: list = field(default_factory=list)
    total_s: float = float("nan")


def knowledge_of(cell: NatureCell) -> Knowledge:
    """What the owner states."""
    stated = cell.stated
    return Knowledge(
        link_std=stated.link_std,
        efficiency=stated.efficiency,
        gear_ratio=stated.gear_ratio,
        gain_std=tuple(float(value) for value in stated.gain_std),
    )


def first_diagnosis(cell: NatureCell, *only: str) -> Result:
    """Diagnosis of the first recording alone, by these effects or, where none is given, by the whole library."""
    table, robot = simulated_table(cell.measure(cell.visits)[0], "first"), robot_from_urdf(cell.stated.urdf, "drawn")
    return diagnose(table, robot, knowledge_of(cell), only=frozenset(only))


def run_nuisance_only(task: tuple[int, str, bool]) -> dict:
    """Score of an arm with nothing beyond nuisances: seed, condition, whether it is diagnosed too."""
    seed, condition, diagnosed = task
    cell = draw_cell(seed, condition)
    columns, outliers = cell.measure(cell.visits)
    table, robot = simulated_table(columns, "nature"), robot_from_urdf(cell.stated.urdf, f"seed {seed}")
    oracle = load_std(cell, cell.visits, outliers)
    begin, refused, parts = time.process_time(), [], {}
    try:
        estimate_result = estimate(table, robot, knowledge_of(cell), "joint")
        parts["estimated"] = _intervals(cell, _tool(estimate_result.loads), oracle)
    except GatewayError as error:
        refused.append(f"estimate: {error}")
    if diagnosed:
        try:
            parts |= _said(cell, diagnose(table, robot, knowledge_of(cell)), oracle)
        except GatewayError as error:
            refused.append(f"diagnose: {error}")
    return asdict(_score(cell, cell.visits, outliers, parts, refused, time.process_time() - begin))


def run_effect(seed: int) -> dict:
    """Score of an arm with something beyond nuisances, the robot at hand for more poses and fresh ones."""
    cell = draw_effect_cell(seed)
    robot = robot_from_urdf(cell.stated.urdf, f"seed {seed}")
    side = Robotside(cell)
    begin, refused, parts = time.process_time(), [], {}
    try:
        result, _ = close_loop(side.first(), robot, knowledge_of(cell), side.measure, cell.poses(VALIDATION, 1))
        asked = cell.kind not in ("strange", "wiring")
        oracle = load_std(cell, side.visits, side.outliers) if asked else np.full(4, np.nan)
        log_ratios = log_likelihood_ratios(cell, side.visits, side.outliers) if asked else []
        parts = _said(cell, result, oracle) | {"log_ratios": log_ratios}
    except GatewayError as error:
        refused.append(f"diagnose: {error}")
    return asdict(_score(cell, side.visits, side.outliers, parts, refused, time.process_time() - begin))


def run_timed(seed: int) -> dict:
    """CPU time [s] of a diagnosis of 40 poses, bare and loaded."""
    cell = draw_cell(seed, "all")
    visits = [
        PlannedVisit(number, label, VISIT_S * (number + TIMED_POSES * place), q)
        for place, label in enumerate(("none", "tool"))
        for number, q in enumerate(cell.poses(TIMED_POSES, 2))
    ]
    table = simulated_table(cell.measure(visits, 99)[0], "many")
    robot, options = robot_from_urdf(cell.stated.urdf, f"seed {seed}"), knowledge_of(cell)
    begin = time.process_time()
    diagnose(table, robot, options)
    return {"seed": seed, "time_s": time.process_time() - begin}


class Robotside:
    """Drives to poses and measures, as the engineer's cell would; keeps what was visited and what went wrong."""

    def __init__(self, cell: NatureCell) -> None:
        self.cell = cell
        self.visits: list[PlannedVisit] = []
        self.outliers: list[OutlierVisit] = []
        self.calls = 0
        self.next_pose = max(visit.pose for visit in cell.visits) + 1
        self.time_s = max(visit.time_s for visit in cell.visits) + 3 * VISIT_S

    def first(self) -> Table:
        """The first recording."""
        return self._measured(self.cell.visits)

    def measure(self, poses_rad: Floats) -> Table:
        """Visits of new poses with the load on."""
        visits = [
            PlannedVisit(self.next_pose + k, "tool", self.time_s + VISIT_S * k, q) for k, q in enumerate(poses_rad)
        ]
        self.next_pose += len(visits)
        self.time_s += VISIT_S * len(visits)
        return self._measured(visits)

    def _measured(self, visits: Sequence[PlannedVisit]) -> Table:
        columns, outliers = self.cell.measure(visits, self.calls)
        before = len(self.visits)
        self.outliers += [OutlierVisit(g.visit + before, g.pose, g.load, g.joint, g.bands) for g in outliers]
        self.visits += visits
        self.calls += 1
        return simulated_table(columns, f"nature{self.calls}")


def truth_of(cell: NatureCell) -> list:
    """Mechanism, joints and strength of what is beyond nuisances."""
    return [(e.mechanism, list(e.joints), s) for e, s in zip(cell.effects, cell.strengths, strict=True)]


def _said(cell: NatureCell, result: Result, oracle: Floats) -> dict:
    return {
        "diagnosed": _intervals(cell, _tool(result.loads), oracle),
        "found": [(effect.name, list(effect.joints)) for effect in result.effects],
        "verdict": str(result.verdict),
        "set_aside": [(entry.pose, entry.load, entry.joint, entry.bands) for entry in result.set_aside],
        "formula": [piece.expression for piece in result.formula.pieces] if result.formula else [],
        "formula_left": _formula_left(result),
    }


def _formula_left(result: Result) -> float:
    if result.formula is None:
        return float("nan")
    noise_nm = np.array(result.noise_floor_nm)[[joint - 1 for joint in result.formula.joints] or slice(None)]
    left = np.subtract(result.formula.residual_nm, result.formula.predicted_nm)
    return float(np.sqrt(np.mean(left**2) / np.nanmean(noise_nm**2)))


def _tool(loads: Sequence[LoadEstimate] | Sequence[LoadResult]) -> LoadEstimate | LoadResult | None:
    return next((load for load in loads if load.label == "tool"), None)


def _intervals(cell: NatureCell, load: LoadEstimate | LoadResult | None, oracle: Floats) -> Intervals:
    nothing = [float("nan")] * 4
    if load is None or load.com_m is None or load.com_std_m is None:
        return Intervals(nothing, nothing)
    truth = np.array([cell.arm.tool.mass_kg, *cell.arm.tool.com_m])
    value = np.array([load.mass_kg, *load.com_m], dtype=float)
    std = np.array([load.mass_std_kg, *load.com_std_m], dtype=float)
    inside = np.where(np.isfinite(std), np.abs(value - truth) < HALF_WIDTH * std, np.nan)
    return Intervals([float(v) for v in inside], [float(v) for v in std / oracle])


def _score(
    cell: NatureCell,
    visits: Sequence[PlannedVisit],
    outliers: Sequence[OutlierVisit],
    parts: dict,
    refused: list,
    total_s: float,
) -> Score:
    return Score(
        seed=cell.seed,
        condition=cell.condition,
        kind=cell.kind,
        misstated=cell.stated.misstated,
        truth=truth_of(cell),
        beside=list(strengths_beside(cell.arm, cell.visits, rows_of(cell.visits), cell.effects)),
        visits=[(visit.pose, visit.load) for visit in visits],
        outliers=[(g.pose, g.load, g.joint, g.bands) for g in outliers],
        refused=refused,
        total_s=total_s,
        **parts,
    )
