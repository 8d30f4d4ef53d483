"""One blind cell from start to end: first recording, diagnosis, more poses where asked for, fresh validation, score."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.blind.drawn_arm import VISIT_S
from benchmarks.blind.drawn_cell import BlindCell, draw_cell, strength_beyond
from gateway.data.table import Table
from gateway.diagnose import close_loop, diagnose
from gateway.diagnose.rest.rest_mistakes import Mistake
from gateway.diagnose.rest.search import Search
from gateway.identify.knowledge import Knowledge
from gateway.identify.rest.linear import Fit
from gateway.identify.rest.problem import build_problem
from gateway.identify.rest.rest_loads import loads_of
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effect import RestSetup
from gateway.model.effects import terms_at_rest
from gateway.model.robot import Robot, robot_from_urdf
from gateway.model.visits import pair_visits
from gateway.result.result import LoadResult, Result
from sim.blind import LEAST_STRENGTH
from sim.offline import PlannedVisit
from tests.support.rigs.tables import simulated_table

MISTAKES = ("sign_reversed", "axes_swapped", "current_rms_peak")
VALIDATION = 4
TIMED, TIMED_POSES = 10, 40


@dataclass(frozen=True, slots=True)
class Score:
    """What is kept of one cell."""

    seed: int
    kind: str
    truth: list
    strengths: list
    found: list
    verdict: str
    rounds: int
    holdout_over_floor: float
    load_errors: list
    errors_with_effects: list
    inside: list
    first_s: float
    total_s: float
    odds: list
    next: list
    structure_p: float
    beyond: list


class Robotside:
    """Drives to poses and measures, as the engineer's cell would; numbers new poses and lets time pass."""

    def __init__(self, cell: BlindCell) -> None:
        self.cell = cell
        self.next_pose = max(visit.pose for visit in cell.visits) + 1
        self.time_s = max(visit.time_s for visit in cell.visits) + 2 * VISIT_S
        self.calls = 0

    def measure(self, poses_rad: np.ndarray) -> Table:
        """Visits of new poses with the load on."""
        self.calls += 1
        visits = self.cell.later(poses_rad, self.next_pose, self.time_s)
        self.next_pose += len(visits)
        self.time_s += VISIT_S * len(visits)
        return simulated_table(self.cell.measure(visits, self.calls), f"more{self.calls}")


def knowledge_of(cell: BlindCell) -> Knowledge:
    """What the cell file of this arm says."""
    arm = cell.arm
    return Knowledge(link_std=0.05, known=arm.known, efficiency=arm.efficiency, gear_ratio=arm.gear_ratio)


def run_cell(seed: int) -> dict:
    """Draw, measure, diagnose, decide, validate and score one seed."""
    cell = draw_cell(seed)
    robot = robot_from_urdf(cell.arm.urdf, f"seed {seed}")
    table = simulated_table(cell.measure(cell.visits), "first")
    knowledge = knowledge_of(cell)
    first_s = _time_of_many(cell, robot, knowledge) if seed % TIMED == 0 else float("nan")
    begin = time.process_time()
    side = Robotside(cell)
    result, fitted = close_loop(table, robot, knowledge, side.measure, cell.poses(VALIDATION, 3))
    times = (first_s, time.process_time() - begin, side.calls - 1)
    return asdict(_score(cell, robot, knowledge, result, fitted, times))


def _time_of_many(cell: BlindCell, robot: Robot, knowledge: Knowledge) -> float:
    """CPU time [s] of a diagnosis of many poses, each bare and with the load."""
    poses = cell.poses(TIMED_POSES, 9)
    visits = [
        PlannedVisit(number, label, VISIT_S * (number + TIMED_POSES * place), q)
        for place, label in enumerate(("none", "tool"))
        for number, q in enumerate(poses)
    ]
    table = simulated_table(cell.measure(visits, 99), "many")
    begin = time.process_time()
    diagnose(table, robot, knowledge)
    return time.process_time() - begin


def true_labels(cell: BlindCell) -> list[tuple[str, tuple[int, ...], float]]:
    """Effects strong enough to count, with their strengths."""
    pairs = zip(cell.truth.effects, cell.truth.strengths, strict=True)
    return [(str(e["name"]), tuple(e["joints"]), s) for e, s in pairs if s >= LEAST_STRENGTH]  # type: ignore[arg-type]


def _score(cell: BlindCell, robot: Robot, knowledge: Knowledge, result: Result, table: Table, times: tuple) -> Score:
    truth = true_labels(cell)
    kind = cell.truth.kind
    if not truth:
        kind = "clean"
    elif kind == "two" and len(truth) == 1:
        kind = "one"
    after = np.array(result.after.holdout_rms_nm)
    over = float(np.sqrt(np.nanmean((after / cell.arm.floor_nm) ** 2)))
    loads, loads_with_effects, inside = [], [], []
    if result.loads and kind != "off":
        loads = _errors(cell, result.loads[0])
        loads_with_effects = _errors(
            cell, loads_knowing_effects(cell, robot, knowledge, table, [entry[:2] for entry in truth])[0]
        )
        inside = _inside(cell, result.loads[0])
    return Score(
        seed=cell.seed,
        kind=kind,
        truth=[entry[:2] for entry in truth],
        strengths=[entry[2] for entry in truth],
        found=[(effect.name, tuple(effect.joints)) for effect in result.effects],
        verdict=str(result.verdict),
        rounds=times[2],
        holdout_over_floor=over,
        load_errors=loads,
        errors_with_effects=loads_with_effects,
        inside=inside,
        first_s=times[0],
        total_s=times[1],
        odds=[float(min(effect.evidence.odds, 1e9)) for effect in result.effects],
        next=[entry.what for entry in result.next],
        structure_p=float(result.provenance.get("structure_p", 1.0)),
        beyond=_beyond(cell),
    )


def _beyond(cell: BlindCell) -> list:
    """Every effect built in, with its joints and its strength beyond nuisance parameters."""
    entries = []
    for effect, size in zip(cell.truth.effects, cell.truth.strengths, strict=True):
        # friction that changes with the position is in the half-differences, where gains and biases do not reach
        friction = effect["name"] == "position_friction"
        beyond = size if friction else strength_beyond(cell.arm, cell.visits, effect)
        entries.append((effect["name"], effect["joints"], beyond))
    return entries


def _truth_load(cell: BlindCell) -> np.ndarray:
    tool = cell.arm.loads["tool"]
    return np.array([tool.mass_kg, *tool.com_m])


def _errors(cell: BlindCell, load: LoadResult) -> list[float]:
    """Relative error of the mass, distance of the centre of gravity over the reach of the arm's last links."""
    if load.com_m is None:
        return []
    truth = _truth_load(cell)
    return [abs(load.mass_kg / truth[0] - 1.0), float(np.linalg.norm(np.array(load.com_m) - truth[1:]))]


def _inside(cell: BlindCell, load: LoadResult) -> list[bool]:
    """Whether the 95 % intervals of mass, x, y, z hold the truth."""
    if load.com_m is None or load.com_std_m is None:
        return []
    truth = _truth_load(cell)
    value = np.array([load.mass_kg, *load.com_m])
    std = np.array([load.mass_std_kg, *load.com_std_m])
    return [bool(v) for v in np.abs(value - truth) < 1.96 * std]


def loads_knowing_effects(
    cell: BlindCell, robot: Robot, knowledge: Knowledge, table: Table, truth: list
) -> tuple[LoadResult, ...]:
    """Return the loads of an estimator that is given the effects present, but not their sizes."""
    for effect in cell.truth.effects:
        if effect["name"] in MISTAKES:
            factor = float(effect["parameters"].get("factor", 1.0))  # type: ignore[union-attr]
            mistake = Mistake(str(effect["name"]), tuple(effect["joints"]), factor, True)  # type: ignore[arg-type]
            table = mistake.undo(table)
    rows = pair_visits(table, knowledge.efficiency)
    problem = build_problem(robot, rows, Knowledge(link_std=0.05, known=knowledge.known))
    noise = first_noise(problem)
    torque = np.abs(np.nan_to_num(rows.sum_nm))
    terms = terms_at_rest(rows, RestSetup(knowledge.gear_ratios(rows.axes), bool(knowledge.known), torque))
    search = Search(problem, tuple(terms), (), noise)
    best: list[Fit] = [search.fitted(())]
    for name, joints in truth:
        if name in MISTAKES:
            continue
        shapes = [term for term in terms if term.label == (name, tuple(joints))]
        start = best[-1]
        best.append(search.best([search.fitted((*start.terms, shape), start) for shape in shapes]))
    return loads_of(problem, best[-1], robot)
