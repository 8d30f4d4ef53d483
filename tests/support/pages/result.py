"""A result as the commands write it: two loads, a balancer found, fourteen poses, four of them fresh."""

import math

import numpy as np

GRAVITY = np.array([60.0, 900.0, 420.0, 25.0, 18.0, 0.4])
FLOOR = [1.2, 6.0, 3.1, 0.5, 0.42, 0.3]
BAND = [9.0, 40.0, 22.0, 4.0, 3.1, 2.2]
LOAD_KG = {"none": 0.0, "tool": 25.0, "tool+part": 71.3}
REJECTED = (
    ("torque_constant_scale", [2], 0.71),
    ("joint_zero_offset", [2], 0.78),
    ("base_tilt", [], 0.97),
    ("link_mass", [3], 0.93),
    ("load_dependent_friction", [2], 0.99),
    ("cable_torque", [5], 1.0),
    ("axis_coupling", [5, 6], 1.02),
    ("torque_offset", [2], 1.31),
)
COLUMNS = ("run", "load", "pose", "time_s", "q_rad", "direction", "tau_nm", "model_nm", "band_nm", "std_nm")


def _points(q):
    """Base, joints and flange of a plain arm [m]."""
    points = [[0.0, 0.0, 0.3], [0.0, 0.0, 0.6]]
    r, z = 0.35, 0.85
    c, s = math.cos(q[0]), math.sin(q[0])
    points.append([r * c, r * s, z])
    for length, angle in ((1.1, q[1]), (1.1, q[1] + q[2] + math.pi / 2), (0.3, q[1] + q[2] + q[4] + math.pi / 2)):
        r, z = r + length * math.sin(angle), z + length * math.cos(angle)
        points.append([r * c, r * s, z])
    return points


def _poses(rng):
    first = [rng.uniform(-2, 2, 14), rng.uniform(-0.7, 0.7, 14), rng.uniform(-0.6, 0.5, 14)]
    return np.column_stack([*first, *rng.uniform(-1.5, 1.5, (3, 14))])


def _measured(poses, rng):
    """Rows of the result, what the model said before, and the role of each row."""
    rows = {key: [] for key in COLUMNS}
    before, roles = [], []
    for label, mass_kg in LOAD_KG.items():
        for number, q in enumerate(poses, start=1):
            shape = np.array([0.02 * math.sin(q[0]), math.sin(q[1] - 0.3), math.sin(q[1] + q[2]), *np.sin(q[3:])])
            model = GRAVITY * shape * (1 + mass_kg / 90)
            band = np.array(BAND) * rng.uniform(0.8, 1.25, 6)
            tau = model + rng.normal(0, FLOOR)
            values = ("run", label, number, 12.0 * number, q, [0] * 6, tau, model, band, FLOOR)
            for key, value in zip(COLUMNS, values, strict=True):
                rows[key].append(value.tolist() if isinstance(value, np.ndarray) else value)
            before.append((model - [0, 80 * math.sin(q[1]), 0, 0, 0, 0]).tolist())
            roles.append("fresh" if number > 10 else "fit")
    return rows, before, roles


def _drawn(poses):
    entries = []
    for number, q in enumerate(poses, start=1):
        points = _points(q)
        com = [last + 0.8 * (last - earlier) for last, earlier in zip(points[-1], points[-2], strict=True)]
        role = "fresh" if number > 10 else "fit"
        entry = {"pose": number, "load": "tool", "role": role, "q_rad": q.tolist(), "points_m": points, "com_m": com}
        entries.append(entry)
    return entries


def _curve(poses, rng):
    x = np.linspace(-0.75, 0.75, 40)
    return {
        "name": "balancer_spring",
        "joint": 2,
        "x_label": "q2",
        "x_unit": "rad",
        "y_label": "J2 torque of the effect [Nm]",
        "x": x.tolist(),
        "y": (160 * np.sin(x)).tolist(),
        "low": (150 * np.sin(x) - 6).tolist(),
        "high": (170 * np.sin(x) + 6).tolist(),
        "points_x": poses[:, 1].tolist(),
        "points_y": (160 * np.sin(poses[:, 1]) + rng.normal(0, 6, len(poses))).tolist(),
    }


def _load(label, mass, std, com):
    return {
        "label": label,
        "mass_kg": mass,
        "mass_std_kg": std,
        "com_m": [com[0], com[1], com[2] + 0.1],
        "frame": "link_6",
        "com_std_m": [std / 100, std / 90, std / 50],
        "com_flange_m": com,
        "correlation": [[1, 0.1, 0, -0.6], [0.1, 1, 0.2, 0.5], [0, 0.2, 1, 0.1], [-0.6, 0.5, 0.1, 1]],
        "unidentifiable": [],
        "per_pose_mass_kg": {"1": mass},
    }


def _axis_constants():
    return {
        "gear_ratio": {"value": 210.0, "unit": "-", "source": "datasheet p. 12"},
        "gear_efficiency": {"value": 0.8, "unit": "-", "source": "assumed"},
        "rated_torque": {"value": 23.875, "unit": "Nm", "source": "read from drive 0x6076"},
    }


def _effect():
    return {
        "name": "balancer_spring",
        "joints": [2],
        "parameters": {"stiffness_n_m": 84210.0, "length_m": 0.412},
        "std": {"stiffness_n_m": 1900.0},
        "evidence": {
            "holdout_rms_ratio": 0.068,
            "p_value": 3e-14,
            "runner_up": "torque_constant_scale",
            "odds": 4.2e6,
        },
    }


def full_result() -> dict:
    """The result as a dictionary."""
    rng = np.random.default_rng(7)
    poses = _poses(rng)
    rows, before_nm, roles = _measured(poses, rng)
    after = [_load("tool", 25.03, 0.11, [0.0121, -0.0034, 0.18]), _load("tool+part", 71.22, 0.16, [0.03, 0.001, 0.241])]
    before = [_load("tool", 27.9, 0.9, [0.019, -0.004, 0.166]), _load("tool+part", 74.6, 1.1, [0.037, 0.002, 0.221])]
    return {
        "schema": 1,
        "robot": "qh165",
        "method": "joint",
        "loads": after,
        "verdict": "explained",
        "effects": [_effect()],
        "before": {
            "rms_nm": [1.2, 71.0, 3.3, 0.5, 0.4, 0.3],
            "holdout_rms_nm": [1.3, 88.0, 4.9, 0.55, 0.46, 0.31],
            "loads": before,
        },
        "after": {
            "rms_nm": [1.1, 5.6, 3.0, 0.5, 0.4, 0.3],
            "holdout_rms_nm": [1.3, 6.3, 3.2, 0.52, 0.45, 0.31],
            "loads": after,
        },
        "holdout_kind": "fresh",
        "noise_floor_nm": FLOOR,
        "friction_band_nm": BAND,
        "rejected": [{"name": name, "joints": joints, "holdout_rms_ratio": ratio} for name, joints, ratio in REJECTED],
        "next": [
            {
                "what": "measure one pose with the forearm level to tighten z",
                "poses_rad": [poses[3].tolist()],
                "tells_apart": [],
                "reduction": 0.82,
            }
        ],
        "findings": [
            {
                "severity": "info",
                "where": "J6",
                "what": "friction band above 10 % of the torque limit",
                "advice": "warm the axis up and repeat",
            }
        ],
        "provenance": {f"J{axis}": _axis_constants() for axis in range(1, 7)},
        "rows": rows,
        "data": {
            "created": "2026-03-02 14:05",
            "software": "servo-gateway 0.1.0",
            "cell": "large",
            "arm": "main",
            "poses": _drawn(poses),
            "model_before_nm": before_nm,
            "role": roles,
            "curves": [_curve(poses, rng)],
            "bus": [{"bus": "a", "cycles": 48211, "incomplete": 0, "late": 0, "planned_load_percent": 41.9, "emcy": 0}],
            "sources": [{"file": "out/run.h5", "kind": "recording", "visits": 42, "exit_status": "success"}],
        },
    }
