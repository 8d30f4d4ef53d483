"""Cycle time of `cost` against two solvers of their own, which take torque from pinocchio.

The first searches speed, acceleration and deceleration of a jerk-limited motion on a grid, for the shortest motion
that keeps the torque limits. The second is the time-optimal law of the path without a jerk limit (Verscheure et al.
2009, as a linear program over the squared speed): no planner is faster.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq, linprog

from benchmarks.cell_file import invoked

Floats = np.ndarray
EXAMPLE = Path(__file__).parents[2] / "examples" / "large"
#: Friction band of every axis in the result [Nm].
BAND_NM = (40.0, 60.0, 40.0, 15.0, 15.0, 8.0)
WAYPOINTS = 5
#: Instants of a motion, points of a path.
INSTANTS, POINTS = 160, 80
DWELL_S = 0.2


@dataclass(frozen=True)
class Axes:
    """Constants (6,) of the axes, from the text of the cell file."""

    speed: Floats
    acceleration: Floats
    jerk: Floats
    torque: Floats
    efficiency: Floats
    rotor: Floats


@dataclass(frozen=True)
class Plant:
    """Pinocchio's arm with a load, and its axes."""

    model: pin.Model
    axes: Axes

    def share(self, q: Floats, qd: Floats, qdd: Floats, direction: Floats) -> Floats:
        """Motor torque (n, 6) over its limit: gear losses in the direction of the motion, rotor before the gear."""
        data = self.model.createData()
        rows = zip(q, qd, qdd, strict=True)
        force = np.array([pin.rnea(self.model, data, *row).copy() for row in rows]) + np.array(BAND_NM) * direction
        driving = force * direction > 0.0
        motor = np.where(driving, force / self.axes.efficiency, force * self.axes.efficiency) + self.axes.rotor * qdd
        return motor / self.axes.torque


def cost_of_path(seed: int) -> dict:
    """Draw a cell, a load and a path; return cycle times [s] of `cost` and of both solvers, with and without load."""
    rng = np.random.default_rng([seed, 39])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(EXAMPLE / "robot.urdf", folder)
        cell = (EXAMPLE / "cell.toml").read_text(encoding="utf-8")
        for key, value in (
            ("acceleration_limit_rad_s2", rng.uniform(4, 12)),
            ("speed_limit_rad_s", rng.uniform(1.0, 1.7)),
            ("jerk_limit_rad_s3", rng.uniform(40, 120)),
        ):
            cell = "\n".join(f"{key} = {value:.3f}" if line.startswith(key) else line for line in cell.splitlines())
        (folder / "cell.toml").write_text(cell, encoding="utf-8")
        axes = _axes(tomllib.loads(cell)["arm"][0]["axis"])
        mass_kg, com_m = rng.uniform(80, 165), rng.uniform([-0.1, -0.1, 0.1], [0.1, 0.1, 0.3])
        (folder / "result.json").write_text(json.dumps(_result(mass_kg, com_m)), encoding="utf-8")
        for _ in range(100):
            points = rng.uniform([-1.0, -0.6, -0.6, -1, -1, -1], [1.0, 0.8, 0.8, 1, 1, 1], (WAYPOINTS, 6))
            path = f"dwell_s = {DWELL_S}\nwaypoints_rad = {points.tolist()}\n"
            (folder / "path.toml").write_text(path, encoding="utf-8")
            words = ("cost", folder / "cell.toml", folder / "result.json", "--path", folder / "path.toml")
            code, said = invoked(*words, "--json", folder / "cost.json")
            if code != 5:
                break
        if code != 0:
            return {"seed": seed, "said": said[-300:]}
        settings = json.loads((folder / "cost.json").read_text(encoding="utf-8"))["moves"][0]["settings"]
    found: dict = {"seed": seed}
    for setting in (settings[0], settings[-1]):
        mass = 0.0 if setting["name"] == "no load" else mass_kg
        plant = Plant(_model(mass, com_m), axes)
        pairs = list(zip(points[:-1], points[1:], strict=True))
        found[setting["name"]] = {
            "predicted_s": setting["cycle_time_s"],
            "searched_s": sum(fastest_s(plant, *pair) + DWELL_S for pair in pairs),
            "optimal_s": sum(optimal_s(plant, *pair) + DWELL_S for pair in pairs),
            "limited_by": [segment["limited_by"] for segment in setting["segments"]],
        }
    return found


def _axes(tables: list[dict]) -> Axes:
    def of(key: str) -> Floats:
        return np.array([axis[key]["value"] if isinstance(axis[key], dict) else axis[key] for axis in tables])

    limits = ("speed_limit_rad_s", "acceleration_limit_rad_s2", "jerk_limit_rad_s3", "torque_limit_nm")
    return Axes(*(of(key) for key in (*limits, "gear_efficiency", "rotor_inertia_kg_m2")))


def _result(mass_kg: float, com_m: Floats) -> dict:
    load = {"label": "a", "mass_kg": mass_kg, "mass_std_kg": 0.5, "com_m": com_m.tolist(), "com_std_m": [0.002] * 3}
    return {"schema": 1, "robot": "qh165", "loads": [load], "friction_band_nm": list(BAND_NM)}


def _model(mass_kg: float, com_m: Floats) -> pin.Model:
    """Return the arm with a solid cube of 3000 kg/m3."""
    model = pin.buildModelFromUrdf(str(EXAMPLE / "robot.urdf"))
    if mass_kg:
        inertia = np.eye(3) * mass_kg * (mass_kg / 3000.0) ** (2.0 / 3.0) / 6.0
        model.appendBodyToJoint(6, pin.Inertia(mass_kg, com_m, inertia), pin.SE3.Identity())
    return model


def fastest_s(plant: Plant, start: Floats, end: Floats) -> float:
    """Duration of the fastest jerk-limited straight motion, by a grid over speed, acceleration and deceleration."""
    moved = end - start
    most = [float((limit / np.abs(moved)).min()) for limit in (plant.axes.speed, plant.axes.acceleration)]
    jerk = float((plant.axes.jerk / np.abs(moved)).min())
    best = (np.inf, np.ones(3))
    for centre, width, count in ((None, 1.0, 14), (1, 0.1, 9), (1, 0.025, 9), (1, 0.007, 7)):
        around = np.full(3, 0.52) if centre is None else best[1]
        reach = 0.48 if centre is None else width
        grids = [np.unique(np.clip(np.linspace(one - reach, one + reach, count), 0.02, 1.0)) for one in around]
        for shares in sorted(product(*grids), key=lambda each: -sum(each)):
            speed, rise, fall = shares[0] * most[0], shares[1] * most[1], shares[2] * most[1]
            phases = _phases(speed, rise, fall, jerk)
            duration = sum(phase[0] for phase in phases)
            if duration < best[0] and _kept(plant, start, moved, _sampled(phases)):
                best = (duration, np.array(shares))
    return float(best[0])


def _ramp(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Times of constant jerk and of constant acceleration of a ramp from rest."""
    if acceleration**2 / jerk >= speed:
        return float(np.sqrt(speed / jerk)), 0.0
    return acceleration / jerk, speed / acceleration - acceleration / jerk


def _phases(speed: float, rise: float, fall: float, jerk: float) -> list[tuple[float, float]]:
    """Duration and jerk of the seven phases of a motion over the distance 1 with a speed limit."""

    def rest(most: float) -> float:
        ramps = (most * (2 * jerking + steady) / 2 for jerking, steady in (_ramp(most, a, jerk) for a in (rise, fall)))
        return 1.0 - sum(ramps)

    top = speed if rest(speed) >= 0.0 else float(brentq(rest, 1e-9, speed))
    (up, up_steady), (down, down_steady) = _ramp(top, rise, jerk), _ramp(top, fall, jerk)
    cruise = max(rest(top), 0.0) / top
    return [(up, jerk), (up_steady, 0), (up, -jerk), (cruise, 0), (down, -jerk), (down_steady, 0), (down, jerk)]


def _sampled(phases: list[tuple[float, float]]) -> tuple[Floats, Floats, Floats]:
    """Distance, speed and acceleration at instants, integrated phase by phase."""
    state, begun, rows = np.zeros(3), 0.0, []
    times = np.linspace(0.0, sum(phase[0] for phase in phases), INSTANTS)
    for duration, jerk in phases:
        inside = times[(times >= begun) & (times <= begun + duration)] - begun
        rows.extend(_moved(state, float(at), jerk) for at in inside)
        state, begun = _moved(state, duration, jerk), begun + duration
    distance, speed, acceleration = np.array(rows).T
    return distance, speed, acceleration


def _moved(state: Floats, time: float, jerk: float) -> Floats:
    s, v, a = state
    return np.array(
        [s + v * time + a * time**2 / 2 + jerk * time**3 / 6, v + a * time + jerk * time**2 / 2, a + jerk * time]
    )


def _kept(plant: Plant, start: Floats, moved: Floats, law: tuple[Floats, Floats, Floats]) -> bool:
    q, qd, qdd = (values[:, None] * moved for values in law)
    return bool((np.abs(plant.share(start + q, qd, qdd, np.sign(moved))) <= 1.0).all())


def optimal_s(plant: Plant, start: Floats, end: Floats) -> float:
    """Duration of the time-optimal straight motion without a jerk limit, by a linear program over the squared speed."""
    moved = end - start
    s = (np.arange(POINTS) + 0.5) / POINTS
    rows, bounds = [], []
    for point, (gravity, by_acceleration, by_speed2) in enumerate(_coefficients(plant, start, moved, s)):
        # squared speed at both ends of the interval: its mean, and half its slope as acceleration
        slope = np.zeros((2, POINTS + 1))
        slope[0, point : point + 2], slope[1, point : point + 2] = (0.5, 0.5), (-POINTS / 2, POINTS / 2)
        sign = np.sign(moved)
        for loss in (1.0 / plant.axes.efficiency, plant.axes.efficiency):
            rotor = plant.axes.rotor * moved / loss
            row = sign[:, None] * (np.outer(by_speed2, slope[0]) + np.outer(by_acceleration + rotor, slope[1]))
            rows.append(row)
            bounds.append(plant.axes.torque / loss - sign * gravity)
            if (loss < 1.0).all():
                rows.append(-row)
                bounds.append(plant.axes.torque / loss + sign * gravity)
        most = float((plant.axes.acceleration / np.abs(moved)).min())
        rows.append(np.array([slope[1], -slope[1]]))
        bounds.append(np.array([most, most]))
    limit = float((plant.axes.speed / np.abs(moved)).min()) ** 2
    ends = [(0.0, 0.0), *[(0.0, limit)] * (POINTS - 1), (0.0, 0.0)]
    solved = linprog(-np.ones(POINTS + 1), A_ub=np.vstack(rows), b_ub=np.concatenate(bounds), bounds=ends)
    if solved.x is None:
        return float("nan")
    speed = np.sqrt(np.maximum(solved.x, 0.0))
    return float((2.0 / POINTS / (speed[1:] + speed[:-1])).sum())


def _coefficients(plant: Plant, start: Floats, moved: Floats, s: Floats) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Torque at rest with friction, and by acceleration and squared speed along the path, at each place."""
    data, still = plant.model.createData(), np.zeros(6)
    for at in s:
        q = start + at * moved
        rest = pin.rnea(plant.model, data, q, still, still).copy()
        by_acceleration = pin.rnea(plant.model, data, q, still, moved) - rest
        by_speed2 = pin.rnea(plant.model, data, q, moved, still) - rest
        yield rest + np.array(BAND_NM) * np.sign(moved), by_acceleration, by_speed2


def cost_figures(paths: list[dict]) -> dict[str, dict]:
    """Return how far the predicted cycle time is off both solvers."""
    from benchmarks.figure import figure

    timed = [path[name] for path in paths for name in ("no load", "entered load") if name in path]
    off = [100.0 * abs(each["predicted_s"] / each["searched_s"] - 1.0) for each in timed]
    above = [100.0 * (each["predicted_s"] / each["optimal_s"] - 1.0) for each in timed]
    return {
        f"load cost: cycle time of {len(timed)} plans, most off the searched one": figure(max(off), "<= 2", "%"),
        "load cost: paths that were not planned": figure(sum("said" in path for path in paths), "== 0"),
        "load cost: cycle time above the time-optimal one without a jerk limit, median": figure(
            float(np.median(above)), unit="%", interval=(min(above), max(above))
        ),
    }
