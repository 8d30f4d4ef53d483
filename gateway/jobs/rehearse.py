"""Rehearse a plan before the robot is there: known truth is put into drawn arms of the cell, measured, and diagnosed.

The simulator (`servo-sim rehearse`) draws arms within the statements of the cell file, builds an effect into each, and
measures them at the poses of the plan. Each table goes through the same analysis as that of a real arm. Counted is
which effects are named, from which strength on, what they are confused with, and how well the load is known.

The strength of an effect is its distance from all that links, load, torque constants and friction bias can take over
within what the cell states. Its unit is the standard deviation of the whole table (Mahalanobis distance), so that half
its square is the expected log likelihood ratio. The first arm has the effect at `FIRST_STRENGTH`; each further one at
the strength from which it is named, as far as that is known by then. The chance to be named is a logistic function of
the logarithm of the strength, with one slope for all effects and a detection strength for each.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from gateway.acquire.plan import Plan
from gateway.acquire.planning import make_plan
from gateway.api.analysis import postures
from gateway.cell.config import load_cell
from gateway.diagnose import diagnose
from gateway.errors import ConfigError, GatewayError, InputError
from gateway.estimate import run as estimate_run
from gateway.excite.plan_file import PlanFile, read_plan
from gateway.identify.knowledge import WeighedLoad
from gateway.model.arm_model import arm_named
from gateway.model.effects import MISTAKES
from gateway.motion.assumed import reference_load
from gateway.motion.workspace import workspace_of
from gateway.pipeline.calibrate import Weight, calibrate
from gateway.pipeline.calibrated import Calibrated
from gateway.pipeline.inputs import AnalysisInputs, ModelRequest, collect_inputs, read_rows
from gateway.result.names import REHEARSAL
from gateway.result.numerals import TWO_SIDED_95
from gateway.result.result import LoadResult

Floats = NDArray[np.float64]
Run = dict[str, Any]

#: Arms of a place, and at least of an effect; strength in the first one, factors on it while none was named, and while
#: all were.
ARMS: Final = 3
ARMS_OF_EFFECT: Final = 9
FIRST_STRENGTH: Final = 6.0
UP: Final = 3.0
DOWN: Final = 0.4
#: Usual number of arms without an effect, and most places at which an effect without a size (a mistake) is tried.
CLEAN_ARMS: Final = 24
MISTAKE_PLACES: Final = 6
#: Prior of the logarithm of a detection strength, and of that of the slope: mean and standard deviation.
_STRENGTH_PRIOR: Final = (np.log(6.0), 1.0)
_SLOPE_PRIOR: Final = (np.log(5.0), 0.2)
#: Relative standard deviation of the links where the cell ignores them; of the weighed mass of a calibration.
_UNKNOWN_LINKS: Final = 0.1
_WEIGHED: Final = 0.001
#: Families of effects, each judged as a whole.
FAMILIES: Final[Mapping[str, tuple[str, ...]]] = {
    "gravity and geometry": ("base_tilt", "joint_zero_offset", "link_mass", "payload_shift"),
    "springs, cables, elasticity": ("balancer_spring", "cable_torque", "joint_elasticity"),
    "friction": ("load_dependent_friction",),
    "torque reading": ("torque_constant_scale", "torque_offset", "torque_ripple", "thermal_drift", "axis_coupling"),
    "wiring and settings": ("sign_reversed", "axes_swapped", "current_rms_peak"),
}


def rehearse(
    cell: Path,
    arm_name: str | None = None,
    plan_file: Path | None = None,
    effects: Collection[str] = (),
    clean_arms: int = CLEAN_ARMS,
    *,
    earlier: Mapping[str, Any] | None = None,
    done: Callable[[Mapping[str, Any], int, int], None] = lambda _body, _done, _total: None,
) -> dict[str, Any]:
    """Rehearse the plan of a cell on all processors.

    Parameters
    ----------
    cell : Path
        Cell file.
    arm_name : str, optional
        Arm to use, if the cell has several.
    plan_file : Path, optional
        What `plan -o` wrote, instead of the plan of the cell.
    effects : collection of str
        Names of the effects to put in; all if empty.
    clean_arms : int
        Number of arms without an effect.
    earlier : mapping, optional
        What an earlier call, stopped or not, gave; its arms are not measured again.
    done : callable
        Called after each place of an effect with the answer so far, and the number of places done and in all.

    Returns
    -------
    dict
        Plain values: `effects` with detection strength and size, `confused`, `families`, `load` with and without a
        calibration, `false_names`, and all `runs`.

    Raises
    ------
    ConfigError, InputError, PlanRefused
        Cell or plan cannot be used, the simulator refuses the cell, an effect cannot be put in, or `earlier` is of
        another cell or plan.
    """
    loaded = load_cell(cell)
    config = arm_named(loaded, arm_name)
    places = _simulated(cell, config.name, {})
    if missing := set(effects) - set(places):
        raise InputError(f"effect '{min(missing)}' cannot be rehearsed; choose from {', '.join(sorted(places))}")
    plan = make_plan(loaded, arm=config.name) if plan_file is None else read_plan(plan_file, config)
    if not isinstance(plan, Plan | PlanFile):
        raise InputError(f"{plan_file}: holds excitation trajectories; rehearse takes a plan of rest poses")
    q_rad, duration_s = [pose.q_rad for pose in plan.poses if pose.purpose == "fit"], plan.duration_s
    about = collect_inputs(ModelRequest(cell=cell, arm=config.name, calibrated=False), ())
    asked = {
        "q_rad": [list(posture) for posture in q_rad],
        "visit_s": duration_s / len(q_rad),
        "largest_kg": reference_load(workspace_of(config, about.model), np.array(q_rad))[0],
        "link_std": min(about.knowledge.trust, _UNKNOWN_LINKS),
        "gain_std": list(about.knowledge.gain_std or ()),
    }
    head: dict[str, Any] = {
        "schema": 1,
        "kind": REHEARSAL,
        "robot": about.model.name,
        "arm": config.name,
        "cell_sha256": hashlib.sha256(loaded.text.encode()).hexdigest(),
        "plan": asked | {"duration_s": duration_s},
    }
    if earlier is not None and any(earlier.get(key) != head[key] for key in ("cell_sha256", "arm", "plan")):
        raise InputError("the rehearsal that is continued is of another cell file, arm or plan: begin a new one")
    runs: list[Run] = list(earlier["runs"]) if earlier is not None else []
    tasks: list[tuple[str | None, list[int], int, int]] = [(None, [], number, 1) for number in range(clean_arms)]
    for number, (name, joints) in enumerate(places.items(), start=1):
        few = joints[:: -(-len(joints) // MISTAKE_PLACES)] if name in MISTAKES else joints
        arms = max(ARMS, -(-ARMS_OF_EFFECT // len(few)))
        tasks += [
            (name, at, 1000 * number + 10 * k, arms) for k, at in enumerate(few) if not effects or name in effects
        ]
    finished = {run["seed"] for run in runs}
    remaining = [task for task in tasks if task[2] not in finished]
    # the arms are independent: one process a processor, each with one thread of linear algebra
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with multiprocessing.get_context("spawn").Pool(None, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        measure = partial(_place, cell, config.name, head["plan"])
        for number, place_runs in enumerate(pool.imap_unordered(measure, remaining), start=1):
            runs += place_runs
            done(head | summary(runs, duration_s), len(tasks) - len(remaining) + number, len(tasks))
    return head | summary(runs, duration_s)


def _simulated(cell: Path, arm: str, request: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer of the simulator's program to a request about an arm."""
    command = [sys.executable, "-m", "sim", "rehearse", str(cell), "--arm", arm]
    ended = subprocess.run(command, input=json.dumps(request), capture_output=True, text=True, check=False)
    if ended.returncode:
        raise ConfigError(f"{cell}: the simulator refuses: {ended.stderr.strip().removeprefix('servo-sim: ')}")
    return json.loads(ended.stdout)


def _place(cell: Path, arm: str, plan: Mapping[str, Any], task: tuple[str | None, list[int], int, int]) -> list[Run]:
    """Draw, measure and diagnose the arms of one place of an effect, or one arm without effect; return their runs."""
    effect, joints, seed, arms = task
    about = collect_inputs(ModelRequest(cell=cell, arm=arm, calibrated=False), ())
    runs: list[Run] = []
    strength = FIRST_STRENGTH
    for attempt in range(arms):
        run = drawn_run(about, plan, partial(_simulated, cell, arm), seed + attempt, effect, joints, strength)
        runs.append(run)
        if run["strength"] is None:
            break
        tried, named = (np.array([run[key] for run in runs]) for key in ("strength", "named"))
        strength = float(DOWN * tried.min() if named.all() else UP * tried.max())
        if named.any() and not named.all():
            strength = float(np.exp(detection(tried, np.zeros(len(runs), dtype=int), named)[0][0]))
    return runs


def drawn_run(
    about: AnalysisInputs,
    plan: Mapping[str, Any],
    simulate: Callable[[Mapping[str, Any]], Mapping[str, Any]],
    seed: int,
    effect: str | None,
    joints: list[int],
    strength: float,
) -> Run:
    """Draw an arm, measure it by a plan, and diagnose it.

    Parameters
    ----------
    about : AnalysisInputs
        Of the cell, without a calibration.
    plan : mapping
        `q_rad` of the poses, `visit_s`, `largest_kg` of the loads, `link_std` and `gain_std`, as `rehearse` answers.
    simulate : callable
        Answers a request as `servo-sim rehearse` does.
    seed : int
    effect, joints, strength
        What is built in; None, [] and any number for an arm without an effect, which is calibrated too.
    """
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.csv"
        request = {**plan, "table": str(table), "seed": seed, "load": 0, "effect": effect, "joints": joints}
        request |= {"strength": strength}
        truth = simulate(request)
        run: Run = {"effect": effect, "joints": joints, "seed": seed, "refused": None, **truth}
        try:
            choice = partial(postures, about)
            result = diagnose(read_rows([table], about), about.model, about.knowledge, pose_choice=choice)
        except GatewayError as error:
            run |= {"verdict": "refused", "found": [], "next": None, "estimate": None, "refused": str(error)}
        else:
            names = [[named.name, list(named.joints)] for named in result.effects]
            poses = [measurement.poses_rad for measurement in result.next if measurement.poses_rad]
            run |= {"verdict": result.verdict, "found": names, "next": poses[0] if poses else None}
            run["estimate"] = _against(result.loads, truth)
        run["listed"] = [effect, joints] in run["found"]
        run["named"] = run["listed"] and run["verdict"] != "undecided"
        if effect is None:
            other = partial(simulate, request | {"load": 1})
            run["calibrated"] = _with_calibration(about, table, truth, other)
    return run


def _against(loads: Iterable[LoadResult], truth: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return errors and standard deviations of the load; None if it is not wholly identified."""
    load = next((load for load in loads if load.label == truth["load"]), None)
    if load is None or load.refused or load.com_m is None or load.com_std_m is None:
        return None
    return {
        "mass_kg": truth["mass_kg"],
        "error": [load.mass_kg - truth["mass_kg"], *np.subtract(load.com_m, truth["com_m"]).tolist()],
        "std": [load.mass_std_kg, *load.com_std_m],
    }


def _with_calibration(
    about: AnalysisInputs, table: Path, weight: Mapping[str, Any], use: Callable[[], Mapping[str, Any]]
) -> dict[str, Any] | None:
    """Calibrate with the load of a table as a weighed one, measure another load of the arm, and estimate that.

    Parameters
    ----------
    about : AnalysisInputs
    table : Path
        Its load is the weighed one; `use` writes the other one there.
    weight : mapping
        Truth of the table.
    use : callable
        Measures the other load, and returns its truth.
    """
    weighed = {weight["load"]: WeighedLoad(weight["mass_kg"], _WEIGHED * weight["mass_kg"])}
    with_weight = replace(about, knowledge=replace(about.knowledge, weighed=weighed))
    reference = Weight.of(weight["load"], with_weight)
    try:
        calibration = calibrate(read_rows([table], about), with_weight, reference, (), datetime.now(UTC), lambda: None)
        scale, std = np.ones(about.model.axes), np.full(about.model.axes, np.nan)
        for axis in calibration.stored.axis:
            scale[axis.joint - 1], std[axis.joint - 1] = axis.torque_scale, axis.std_percent / 100.0
        constants = Calibrated(scale, std)
        knowledge = replace(
            about.knowledge,
            gain_std=constants.gain_std(about.knowledge.gain_std or ()),
            measured_gain=tuple(np.isfinite(constants.std).tolist()),
        )
        truth, after = use(), replace(about, knowledge=knowledge, calibrated=constants)
        result = estimate_run(read_rows([table], after), after.model, knowledge, "joint", pose_choice=None)
    except GatewayError:
        return None
    return _against(result.loads, truth)


def summary(runs: Sequence[Run], duration_s: float) -> dict[str, Any]:
    """Count the runs of a rehearsal.

    Parameters
    ----------
    runs : sequence of dict
        As in the answer of `rehearse`.
    duration_s : float
        Planned motion under one load [s].
    """
    clean = [run for run in runs if run["effect"] is None]
    effects = _effects([run for run in runs if run["effect"] is not None])
    families = []
    for family, names in FAMILIES.items():
        members = [entry for entry in effects if entry["name"] in names]
        if members:
            missed = [{key: entry[key] for key in ("name", "joints")} for entry in members if not entry["recovered"]]
            families.append({"name": family, "recovered": not missed, "missed": missed, "members": len(members)})
    pairs: dict[tuple[str, ...], dict[str, Any]] = {}
    for run in runs:
        truth: str = run["effect"] or ""
        for name, joints in [] if not truth or run["named"] else run["found"]:
            if [name, joints] == [truth, run["joints"]]:
                continue
            names = tuple(sorted((truth, name)))
            pair = pairs.setdefault(names, {"effects": list(names), "arms": 0, "joints": [], "separated_by": None})
            pair["arms"] += 1
            ends = [run["joints"], joints] if truth == names[0] else [joints, run["joints"]]
            pair["joints"] += [] if ends in pair["joints"] else [ends]
            pair["separated_by"] = pair["separated_by"] or run["next"]
    return {
        "time_under_power_s": 2.0 * duration_s,
        "load": {
            "as_stated": _load([run["estimate"] for run in clean]),
            "calibrated": _load([run["calibrated"] for run in clean]),
        },
        "clean_arms": len(clean),
        "false_names": sum(bool(run["found"]) for run in clean),
        "effects": effects,
        "families": families,
        "confused": sorted(pairs.values(), key=lambda pair: -pair["arms"]),
        "runs": list(runs),
    }


def _effects(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one entry a place of an effect: tries, names, and the strength and size from which it is named."""
    order = [name for names in FAMILIES.values() for name in names]
    visited: set[tuple[str, tuple[int, ...]]] = {(run["effect"], tuple(run["joints"])) for run in runs}
    places = sorted(visited, key=lambda place: (order.index(place[0]), place[1]))
    tried = {place: [run for run in runs if (run["effect"], tuple(run["joints"])) == place] for place in places}
    sized = [place for place in places if tried[place][0]["strength"] is not None]
    rows = [(number, run) for number, place in enumerate(sized) for run in tried[place]]
    middle, std, _ = detection(
        np.array([run["strength"] for _, run in rows]),
        np.array([number for number, _ in rows], dtype=int),
        np.array([run["named"] for _, run in rows], dtype=bool),
    )
    entries = []
    for place in places:
        arms = tried[place]
        entry: dict[str, Any] = {"name": place[0], "joints": list(place[1]), "arms": len(arms)}
        entry["named"] = sum(run["named"] for run in arms)
        if place in sized:
            at = sized.index(place)
            strength = float(np.exp(middle[at]))
            per_strength = float(np.median([run["size"] / max(run["strength"], 1e-9) for run in arms]))
            largest = float(np.median([run["size"] / run["largest_share"] for run in arms]))
            entry |= {
                "detection_strength": strength,
                "interval": np.exp(middle[at] + TWO_SIDED_95 * std[at] * np.array([-1.0, 1.0])).tolist(),
                "parameter": arms[0]["parameter"],
                "detection_size": per_strength * strength,
                "largest_size": largest,
                "recovered": entry["named"] > 0 and per_strength * strength <= largest,
            }
        else:
            # an effect of the same torque may be as likely: then the diagnosis lists both
            entry["recovered"] = all(run["listed"] for run in arms)
        entries.append(entry)
    return entries


def detection(strength: Floats, place: NDArray[np.int_], named: NDArray[np.bool_]) -> tuple[Floats, Floats, float]:
    """Estimate from which strength an effect is named in half of the arms.

    The chance is `1 / (1 + exp(-k (log s - m)))` with one slope k for all places and a middle m for each, at the
    maximum of the posterior with weak priors.

    Parameters
    ----------
    strength : array of shape (n,)
    place : int array of shape (n,)
        Place of each run, from 0.
    named : bool array of shape (n,)

    Returns
    -------
    middle, std : arrays of shape (places,)
        Logarithm of the detection strength and its standard deviation.
    slope : float
    """
    count = int(place.max(initial=-1)) + 1
    log_strength = np.log(np.maximum(strength, 1e-6))

    def cost(values: Floats) -> float:
        slope = np.exp(values[-1])
        margin = slope * (log_strength - values[place]) * np.where(named, 1.0, -1.0)
        prior = (
            (values[:-1] - _STRENGTH_PRIOR[0]) / _STRENGTH_PRIOR[1],
            (values[-1] - _SLOPE_PRIOR[0]) / _SLOPE_PRIOR[1],
        )
        return float(np.logaddexp(0.0, -margin).sum() + 0.5 * np.sum(prior[0] ** 2) + 0.5 * prior[1] ** 2)

    start = np.append(np.full(count, _STRENGTH_PRIOR[0]), _SLOPE_PRIOR[0])
    found = minimize(cost, start, method="BFGS").x
    slope = float(np.exp(found[-1]))
    chance = expit(slope * (log_strength - found[place]))
    information = np.full(count, 1.0 / _STRENGTH_PRIOR[1] ** 2)
    np.add.at(information, place, slope**2 * chance * (1.0 - chance))
    return found[:-1], 1.0 / np.sqrt(information), slope


def _load(cases: Sequence[Mapping[str, Any] | None]) -> dict[str, Any] | None:
    """Return what arms without an effect say of the load: stated and real standard deviation, coverage."""
    known = [case for case in cases if case is not None]
    if not known:
        return None
    mass_kg = np.array([case["mass_kg"] for case in known])[:, None]
    unit = np.hstack([mass_kg, np.ones((len(known), 3))])
    error, std = (np.array([case[name] for case in known]) / unit for name in ("error", "std"))
    return {
        "arms": len(known),
        "not_identified": len(cases) - len(known),
        "mass_std_share": float(np.median(std[:, 0])),
        "com_std_m": np.median(std[:, 1:], axis=0).tolist(),
        "mass_rms_error_share": float(np.sqrt(np.mean(error[:, 0] ** 2))),
        "inside": int(np.sum(np.abs(error) <= TWO_SIDED_95 * std)),
        "intervals": int(error.size),
    }
