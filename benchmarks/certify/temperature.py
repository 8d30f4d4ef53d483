"""Recorded temperature against time alone as the regressor of a drift, on simulated arms that warm up and cool down.

The temperature of a motor is a sum of two exponentials: it warms up, cools during a break, and warms up again with the
load. It is recorded once a visit in steps of 0.1 K. The torque constant of axis 2 or 3 drifts with it.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from benchmarks.blind.cells import knowledge_of
from benchmarks.blind.drawn_arm import LOADED_S, VISIT_S, draw_arm
from gateway.diagnose import diagnose
from gateway.model.robot import robot_from_urdf
from sim.draw import choose_poses
from sim.effects import apply_effects
from sim.offline import PlannedVisit, measure, point_jacobian
from tests.support.rigs.tables import simulated_table

POSES = 12
#: Rise [K] of the first motor, time constants of warming up and cooling down [s], share of the first block in motion.
RISE_K, WARMING_S, COOLING_S, MOVING = 30.0, 1800.0, 1500.0, 0.5
#: Of the first motor's rise.
MOTORS = np.array([1.0, 1.1, 1.0, 0.8, 0.8, 0.7])
STEP_C = 0.1


def motor_temperature_c(time_s: float) -> np.ndarray:
    """Temperatures (6,) while the arm moves, waits for its load, and moves again."""
    break_s = MOVING * LOADED_S

    def warmed(for_s: float) -> float:
        return RISE_K * float(-np.expm1(-max(for_s, 0.0) / WARMING_S))

    rise = warmed(min(time_s, break_s))
    if time_s > break_s:
        rise *= float(np.exp(-(min(time_s, LOADED_S) - break_s) / COOLING_S))
    return 25.0 + (rise + warmed(time_s - LOADED_S)) * MOTORS


def drifting_arm(seed: int) -> dict:
    """Error and standard deviation of the mass over the mass, and the named drift, with and without temperatures."""
    rng = np.random.default_rng([seed, 77])
    arm = draw_arm(rng)
    joint, per_k = int(rng.integers(2, 4)), float(rng.choice([-1.0, 1.0]) * rng.uniform(0.004, 0.012))
    effect = {"name": "thermal_drift", "joints": [joint], "parameters": {"per_k": per_k}}
    warm = replace(arm.plant, temperature_c=motor_temperature_c)
    drifting = apply_effects(warm, [effect], point_jacobian(arm.chain))
    poses = choose_poses(arm.chain, arm.floor_nm, arm.prior_std, POSES, rng)
    visits = [
        PlannedVisit(number, label, start_s + VISIT_S * number, q)
        for label, start_s in (("none", 0.0), ("tool", LOADED_S))
        for number, q in enumerate(poses)
    ]
    columns = measure(arm.chain, drifting, visits, arm.loads, arm.protocol, np.random.default_rng([seed, 7]))
    robot, knowledge = robot_from_urdf(arm.urdf, f"seed {seed}"), knowledge_of(SimpleNamespace(arm=arm))
    read_c = np.round(columns["temp_c"] / STEP_C) * STEP_C
    found: dict = {"seed": seed, "per_k": per_k}
    for name, temperature_c in (("temperature", read_c), ("time", np.full_like(read_c, np.nan))):
        result = diagnose(simulated_table(columns | {"temp_c": temperature_c}, "drift"), robot, knowledge)
        load = result.loads[0] if result.loads else None
        if load is None or not np.isfinite(load.mass_kg):
            return found | {"refused": True}
        truth = arm.loads["tool"].mass_kg
        found[name] = {
            "off": load.mass_kg / truth - 1.0,
            "named": any(each.name == "thermal_drift" and each.joints == (joint,) for each in result.effects),
        }
    return found


def temperature_figures(arms: list[dict]) -> dict[str, dict]:
    """Root mean square of the error of the mass with temperatures over that without them, and what was named."""
    from benchmarks.figure import figure

    known = [arm for arm in arms if "time" in arm]

    def rms(how: str) -> float:
        return float(np.sqrt(np.mean([arm[how]["off"] ** 2 for arm in known])))

    printed = {
        "drift: error of the mass with temperatures, root mean square [%]": 100.0 * rms("temperature"),
        "drift: the same with time alone [%]": 100.0 * rms("time"),
        "drift: named with temperatures": float(sum(arm["temperature"]["named"] for arm in known)),
        "drift: named with time alone": float(sum(arm["time"]["named"] for arm in known)),
        "drift: arms whose load is refused": float(len(arms) - len(known)),
    }
    ratio = figure(rms("temperature") / rms("time"), "<= 1")
    return {
        f"drift: error of the mass with temperatures over that with time alone, {len(known)} arms": ratio,
    } | {name: figure(value) for name, value in printed.items()}
