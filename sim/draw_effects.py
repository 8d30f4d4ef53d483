"""Random effects of blind cells: joint and shape are drawn; the size is scaled to the required strength."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sim.draw import DrawnArm

#: Mistakes of commissioning: they have no size, and are drawn alone.
MISTAKES = frozenset({"sign_reversed", "axes_swapped", "current_rms_peak"})

Effect = dict[str, object]

Build = Callable[[float], Effect]
Maker = Callable[[DrawnArm, np.random.Generator], tuple[Build, float | None]]


def _entry(name: str, joints: Sequence[int], **parameters: object) -> Effect:
    return {"name": name, "joints": [int(j) for j in joints], "parameters": parameters}


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _joint(rng: np.random.Generator, first: int = 1, last: int = 6) -> int:
    return int(rng.integers(first, last + 1))


def _effort(arm: DrawnArm, joint: int) -> float:
    """Return the rated torque of one axis, derived from the resolution of its reading [Nm]."""
    return float(arm.protocol.resolution_nm[joint - 1] * 1e3)


def _load_friction(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2)
    return lambda s: _entry("load_dependent_friction", [joint], coefficient=s), 0.4


def _tilt(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    angle = rng.uniform(0, 2 * np.pi)
    x, y = float(np.cos(angle)), float(np.sin(angle))
    return lambda s: _entry("base_tilt", [], tilt_x_rad=s * x, tilt_y_rad=s * y), 0.15


def _zero(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    return lambda s: _entry("joint_zero_offset", [joint], offset_rad=sign * s), 0.15


def _scale(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    return lambda s: _entry("torque_constant_scale", [joint], scale=1.0 + sign * s), 0.3


def _common_scale(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    sign = _sign(rng)
    return lambda s: _entry("torque_constant_scale", [], scale=1.0 + sign * s), 0.3


def _offset(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng), _sign(rng)
    return lambda s: _entry("torque_offset", [joint], offset_nm=sign * s), 0.3 * _effort(arm, joint)


def _drift(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, sign = _joint(rng, 2), _sign(rng)
    if arm.plant.temperature_c is not None:
        return lambda s: _entry("thermal_drift", [joint], per_k=sign * s), 0.03
    return lambda s: _entry("thermal_drift", [joint], per_s=sign * s), 5e-4


def _balancer(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    size = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    lever, anchor = size * rng.uniform(0.12, 0.3), size * rng.uniform(0.35, 0.8)
    shape = {"lever_m": lever, "anchor_m": anchor, "phase_rad": rng.uniform(-0.6, 0.6)}
    if rng.random() < 0.5:
        shape["free_length_m"] = (anchor - lever) * rng.uniform(0.6, 1.0)
    else:
        shape["gas_length_m"] = 2.0 * lever * rng.uniform(1.3, 2.5)
    unit = _effort(arm, 2) / lever / size
    return lambda s: _entry("balancer_spring", [2], stiffness_n_m=s * unit, **shape), 4.0


def _cable(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 4)
    shape: dict[str, object] = {"neutral_rad": rng.uniform(-0.5, 0.5)}
    if rng.random() < 0.3:
        shape["shape"] = "harmonic"
    return lambda s: _entry("cable_torque", [joint], stiffness_nm_rad=s, **shape), 0.3 * _effort(arm, joint)


def _elasticity(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 5)
    return lambda s: _entry("joint_elasticity", [joint], compliance_rad_nm=s), 0.12 / _effort(arm, joint)


def _ripple(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng)
    periods = float(arm.gear_ratio[joint - 1] * rng.integers(1, 3))
    phase = rng.uniform(0, 2 * np.pi)
    return (
        lambda s: _entry("torque_ripple", [joint], amplitude_nm=s, per_revolution=periods, phase_rad=phase),
        0.2 * _effort(arm, joint),
    )


def _coupling(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    pairs = [(5, 6), (2, 3), (4, 5), (4, 6)]
    pair, sign = pairs[int(rng.choice(4, p=[0.4, 0.3, 0.15, 0.15]))], _sign(rng)
    return lambda s: _entry("axis_coupling", pair, coefficient=sign * s), 1.0


def _link_mass(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    link = _joint(rng, 2, 4)
    body = arm.chain.bodies[link - 1]
    reach = float(np.linalg.norm(arm.chain.placement[min(link, 5), :3, 3])) + 0.2
    place = reach * rng.uniform(-0.6, 0.9, 3)
    mass = body.mass_kg if body else 1.0
    return lambda s: _entry(
        "link_mass", [link], mass_kg=s * mass, first_moment_kg_m=[float(v) for v in s * mass * place]
    ), 0.8


def _shift(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    when = float(rng.uniform(*arm.shift_time_s))
    reach = 0.3 * (arm.loads["tool"].mass_kg / 100.0) ** 0.3
    return lambda s: _entry("payload_shift", [], shift_m=[float(v) for v in s * direction], time_s=when), reach


def _reversed(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, None]:
    joint = _joint(rng)
    return lambda _s: _entry("sign_reversed", [joint]), None


def _swapped(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, None]:
    first, second = sorted(int(v) + 1 for v in rng.choice(6, 2, replace=False))
    return lambda _s: _entry("axes_swapped", [first, second]), None


def _rms_peak(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, None]:
    joint, factor = _joint(rng, 2), float(np.sqrt(2.0) ** _sign(rng))
    return lambda _s: _entry("current_rms_peak", [joint], factor=factor), None


MAKERS: dict[str, Maker] = {
    "load_dependent_friction": _load_friction,
    "base_tilt": _tilt,
    "joint_zero_offset": _zero,
    "torque_constant_scale": _scale,
    "torque_constant_scale_common": _common_scale,
    "torque_offset": _offset,
    "thermal_drift": _drift,
    "balancer_spring": _balancer,
    "cable_torque": _cable,
    "joint_elasticity": _elasticity,
    "torque_ripple": _ripple,
    "axis_coupling": _coupling,
    "link_mass": _link_mass,
    "payload_shift": _shift,
    "sign_reversed": _reversed,
    "axes_swapped": _swapped,
    "current_rms_peak": _rms_peak,
}


# ------------------------------------------------------------------------------------------------- off the library


def _hardening(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, phase = _joint(rng, 2, 5), rng.uniform(0, 2 * np.pi)
    return (
        lambda s: _entry("hardening_cable", [joint], amplitude_nm=s, phase_rad=phase),
        0.4 * _effort(arm, joint),
    )


def _buffer(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 5)
    angle = arm.chain.upper_rad[joint - 1] * rng.uniform(0.0, 0.4)
    return (
        lambda s: _entry("end_stop_buffer", [joint], stiffness_nm_rad2=s, angle_rad=angle),
        0.4 * _effort(arm, joint),
    )


def _linkage(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    phase = rng.uniform(0, 2 * np.pi)
    return lambda s: _entry("linkage_spring", [3], stiffness_nm=s, phase_rad=phase), 0.4 * _effort(arm, 3)


def _saturating(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint = _joint(rng, 2, 3)
    reference = _effort(arm, joint)
    return lambda s: _entry("saturating_motor", [joint], coefficient=s, reference_nm=reference), 0.6


def _eccentric(_arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    joint, phase = _joint(rng, 2, 3), rng.uniform(0, 2 * np.pi)
    return lambda s: _entry("eccentric_gear", [joint], coefficient=s, phase_rad=phase), 0.4


def _hose(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    force = rng.standard_normal(3) * [1.0, 1.0, 0.3]
    force /= np.linalg.norm(force)
    unit = _effort(arm, 3)
    return lambda s: _entry("world_hose", [4], force_n=[float(v) for v in s * unit * force]), 0.5


def _bungee(arm: DrawnArm, rng: np.random.Generator) -> tuple[Build, float]:
    reach = float(np.linalg.norm(arm.chain.placement[2, :3, 3]))
    hook = reach * np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(1.5, 2.5)])
    unit = _effort(arm, 3) / reach**2
    return (
        lambda s: _entry(
            "bungee", [3], hook_m=[float(v) for v in hook], stiffness_n_m=s * unit, free_length_m=0.8 * reach
        ),
        0.6,
    )


def _unused(_arm: DrawnArm, _rng: np.random.Generator) -> tuple[Build, None]:
    return lambda _s: _entry("position_friction", []), None


OFF_MAKERS: dict[str, Maker] = {
    "hardening_cable": _hardening,
    "end_stop_buffer": _buffer,
    "linkage_spring": _linkage,
    "saturating_motor": _saturating,
    "eccentric_gear": _eccentric,
    "world_hose": _hose,
    "bungee": _bungee,
    "position_friction": _unused,
}
