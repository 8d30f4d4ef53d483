"""A result of an arm in motion: the load's inertia, friction, rotors and delays, rows of two periods and a sweep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gateway.result.drawn import Drawn
from gateway.result.result import AxisMotion, LoadResult, Result, Rows
from gateway.result.values import matrix, numbers

SIX = np.arange(6)
COULOMB = np.array([42.0, 95.0, 58.0, 17.0, 12.0, 8.1])
VISCOUS = np.array([60.0, 90.0, 71.0, 21.0, 15.0, 9.0])
ROTOR = np.array([220.0, 305.0, 175.0, 31.0, 22.0, 14.0])
GRAVITY = np.array([3.0, 1800.0, 640.0, 42.0, 51.0, 0.7])
NOISE = np.array([9.0, 22.0, 12.0, 4.0, 3.0, 2.0])
PERIOD_S, ROWS = 10.0, 260


def _moved(speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,), and position, speed and acceleration (n, 6) of two sines a joint, as large as `speeds` (6,) say."""
    time_s = np.arange(ROWS) * PERIOD_S / ROWS
    rate = 2 * np.pi / PERIOD_S * (1 + SIX % 3)
    angle = time_s[:, None] * rate + 0.7 * SIX
    size = speeds / rate
    return time_s, size * np.sin(angle), size * rate * np.cos(angle), -size * rate**2 * np.sin(angle)


def _run(name: str, load: str, speeds: np.ndarray, random: np.random.Generator) -> Rows:
    time_s, q, qd, qdd = _moved(speeds)
    friction = np.sign(qd) * COULOMB + VISCOUS * qd
    model = GRAVITY * np.sin(q + 0.4) + ROTOR * qdd + friction
    tau = model + random.normal(0.0, 1.0, q.shape) * NOISE
    return Rows(
        run=(name,) * ROWS,
        load=(load,) * ROWS,
        pose=(-1,) * ROWS,
        time_s=numbers(time_s),
        q_rad=matrix(q),
        direction=((0,) * 6,) * ROWS,
        tau_nm=matrix(tau),
        model_nm=matrix(model),
        band_nm=matrix(np.full(q.shape, np.nan)),
        std_nm=matrix(np.tile(NOISE, (ROWS, 1))),
    )


def moving_result() -> Result:
    """The result; axis 4 has a Stribeck curve, axis 6 no rotor."""
    random = np.random.default_rng(7)
    alone = np.where(SIX == 1, 0.3, 0.0)
    runs = (
        _run("run.h5 period 1", "none", np.full(6, 0.4), random),
        _run("run.h5 period 2", "tool", np.full(6, 0.4), random),
        _run("run.h5 sweep J2", "tool", alone, random),
    )
    fields = Rows.__dataclass_fields__
    rows = Rows(**{name: tuple(item for run in runs for item in getattr(run, name)) for name in fields})
    motion = [
        AxisMotion(
            joint=joint,
            coulomb_nm=float(COULOMB[joint - 1]),
            coulomb_std_nm=float(0.02 * COULOMB[joint - 1]),
            viscous_nm_s_rad=float(VISCOUS[joint - 1]),
            viscous_std_nm_s_rad=float(0.04 * VISCOUS[joint - 1]),
            load_friction=0.04,
            load_friction_std=0.006,
            rotor_inertia_kg_m2=float(ROTOR[joint - 1]),
            rotor_inertia_std_kg_m2=float(0.02 * ROTOR[joint - 1]),
            delay_s=0.0042,
            delay_std_s=0.0003,
            speed_rad_s=0.45,
        )
        for joint in range(1, 7)
    ]
    motion[3] = replace(motion[3], breakaway_nm=24.0, breakaway_std_nm=1.2, stribeck_rad_s=0.06)
    motion[5] = replace(motion[5], rotor_inertia_kg_m2=float("nan"), rotor_inertia_std_kg_m2=float("nan"))
    load = LoadResult(
        label="tool",
        mass_kg=70.1,
        mass_std_kg=0.15,
        com_m=(0.0502, -0.0197, 0.2204),
        com_std_m=(0.0006, 0.0006, 0.0009),
        inertia_kg_m2=(2.04, 3.01, 1.47, 0.38, -0.29, 0.21),
        inertia_std_kg_m2=(0.06, 0.07, 0.05, 0.03, 0.03, 0.04),
    )
    return Result(
        robot="qh165",
        loads=(load,),
        noise_floor_nm=numbers(NOISE),
        rows=rows,
        motion=tuple(motion),
        data=Drawn(created="2026-05-04 10:00 UTC", software="servo-gateway 0.4.0", cell="large", arm="main"),
        method="joint",
    )
