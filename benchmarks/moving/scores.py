"""What a result says of an arm and its load, and what is there: errors, standard deviations, widths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.moving_arm import MovingArm
from benchmarks.nature.moving_cell import PeriodicMotion, rigid_nm
from gateway.result.result import AxisMotion, LoadResult, Result
from sim.plant import Payload

Floats = NDArray[np.float64]

LOAD_NAMES = ("mass", "com x", "com y", "com z", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
AXIS_NAMES = ("coulomb_nm", "viscous_nm_s_rad", "rotor_inertia_kg_m2", "load_friction", "delay_s")
#: Places of the six numbers in an inertia tensor.
_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, slots=True)
class Truth:
    """True load, and true parameters of every axis (N,) by quantity, NaN where there is no such truth.

    `oracle` has the standard deviations of the oracle: `load`, and every quantity of `axes`.
    """

    tool: Payload
    axes: Mapping[str, Floats]
    oracle: Mapping[str, Floats]


def load_truth(tool: Payload) -> Floats:
    """Mass, centre of gravity and inertia about it of a tool (10,), as `LOAD_NAMES`."""
    return np.array([tool.mass_kg, *tool.com_m, *(tool.inertia_kg_m2[place] for place in _SIX)])


def drawn_truth(
    arm: MovingArm, motion: PeriodicMotion, start_s: Mapping[str, float], oracle: Mapping[str, Floats]
) -> Truth:
    """Truth of a drawn arm at the time of its runs, as a result has it: friction with no load, and what a load adds.

    That grows with some power of the load; a result has it over the torque where the torque has its mean size.
    """
    friction = arm.friction
    cold = friction.cold(np.array(list(start_s.values()))).mean(axis=0)
    # undeclared losses of a gear are in proportion to the torque as well: half of what differs by direction
    undeclared = (1.0 / friction.driving - friction.driven) / 2.0
    share = np.mean([np.abs(rigid_nm(arm, motion, label)).mean(axis=0) for label in start_s], axis=0) / arm.rated_nm
    # a gear that transmits nothing is driven by its motor, whichever direction it turns
    idle = cold / friction.driving
    axes = {
        "coulomb_nm": friction.coulomb_nm * idle,
        "viscous_nm_s_rad": arm.viscous_nm_s_rad * idle,
        "rotor_inertia_kg_m2": arm.rotor_inertia_kg_m2,
        "load_friction": friction.load_loss * share ** (friction.load_power - 1.0) + undeclared,
        "delay_s": arm.delay_s,
    }
    return Truth(arm.tool, axes, oracle)


def tensor(six: Any) -> Floats:
    """Inertia tensor (3, 3) of six numbers [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]."""
    out = np.zeros((3, 3))
    for value, (row, column) in zip(six, _SIX, strict=True):
        out[row, column] = out[column, row] = value
    return out


def possible(load: LoadResult) -> bool:
    """Whether a rigid body can have the inertia that was reported; a load without one counts as right."""
    if load.inertia_kg_m2 is None or not np.isfinite(load.inertia_kg_m2).all():
        return True
    moments = np.linalg.eigvalsh(tensor(load.inertia_kg_m2))
    return bool(moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1.0 - 1e-9))


def score(truth: Truth, result: Result | None) -> dict:
    """What is kept of one cell.

    `load`: value, standard deviation (NaN = not given), truth and the oracle's standard deviation of `LOAD_NAMES`;
    `axes`: the same of every axis by its quantity. `impossible`: loads with an inertia that no body has.
    """
    load, oracle = _load_said(result), truth.oracle
    said = {} if result is None else {item.joint: item for item in result.motion}
    count = len(truth.axes["coulomb_nm"])
    true = load_truth(truth.tool).tolist()
    return {
        "load": {"value": load[0], "std": load[1], "truth": true, "oracle": oracle["load"].tolist()},
        "largest_kg_m2": float(np.linalg.eigvalsh(truth.tool.inertia_kg_m2)[-1]),
        "axes": {
            name: {
                "value": _axis_values(said, name, count),
                "std": _axis_values(said, _std_name(name), count),
                "truth": truth.axes[name].tolist(),
                "oracle": oracle[name].tolist(),
            }
            for name in AXIS_NAMES
        },
        "impossible": 0 if result is None else sum(not possible(item) for item in result.loads),
    }


def _std_name(name: str) -> str:
    """Name of the standard deviation in the result."""
    for unit in ("_nm_s_rad", "_kg_m2", "_nm", "_s"):
        if name.endswith(unit):
            return f"{name.removesuffix(unit)}_std{unit}"
    return f"{name}_std"


def _axis_values(said: Mapping[int, AxisMotion], name: str, axes: int) -> list[float]:
    return [float(getattr(said[axis + 1], name)) if axis + 1 in said else float("nan") for axis in range(axes)]


def _load_said(result: Result | None) -> tuple[list[float], list[float]]:
    nothing = [float("nan")] * len(LOAD_NAMES)
    loads = [] if result is None else [load for load in result.loads if load.refused is None]
    if not loads:
        return nothing, nothing
    load = loads[0]
    three, six = [float("nan")] * 3, [float("nan")] * 6
    value = [load.mass_kg, *(load.com_m or three), *(load.inertia_kg_m2 or six)]
    std = [load.mass_std_kg, *(load.com_std_m or three), *(load.inertia_std_kg_m2 or six)]
    return [float(number) for number in value], [float(number) for number in std]
