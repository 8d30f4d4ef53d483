"""Effects that a moving run can show, each as columns of torque beside the rigid body model.

A column that needs a torque takes the modelled one, never the measured one: with a measured torque in a column the
residual explains itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import MovingRows, smooth_sign

Floats = NDArray[np.float64]

# Geometry that a balancer's stiffness is stated for: the torque of a coil of vanishing free length shows only the
# product of stiffness, lever and anchor distance.
LEVER_M = 0.2
ANCHOR_M = 0.7
POLYTROPIC = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """What the model says at the moment: rigid body and all torque (n, 6) [Nm], link parameters of each row (n, 60)."""

    rigid_nm: Floats
    total_nm: Floats
    body: Floats


Columns = Callable[[MovingRows, Modelled], Floats]


@dataclass(frozen=True, slots=True)
class MovingTerm:
    """An effect with fixed shape parameters.

    Attributes
    ----------
    name : str
        Effect as the result file calls it.
    joints : tuple of int
        Joints of the effect, from 0; empty for the base and the load.
    axes : tuple of int
        Axes whose torque the columns enter, from 0.
    columns : function of (MovingRows, Modelled)
        Array of shape (n, len(axes), k) [Nm per unit of the coefficient].
    symbols : tuple of k str
        Names of the coefficients, with unit.
    shape : str
        Which member of a family.
    fixed : dict
        Shape parameters that are not linear, as the result file names them.
    modelled : bool
        Whether the columns depend on the modelled torque.
    """

    name: str
    joints: tuple[int, ...]
    axes: tuple[int, ...]
    columns: Columns = field(compare=False, repr=False)
    symbols: tuple[str, ...]
    shape: str = ""
    fixed: tuple[tuple[str, float], ...] = ()
    modelled: bool = False

    @property
    def key(self) -> tuple[str, tuple[int, ...]]:
        """Name and joints: shapes of one effect share it."""
        return self.name, self.joints


def on_axis(*columns: Floats) -> Floats:
    """Columns (n,) of one axis as (n, 1, k)."""
    return np.stack(columns, axis=1)[:, None, :]


# ---------------------------------------------------------------------------------------------------------- friction


def stribeck(axis: int, fraction: float, top_rad_s: float) -> MovingTerm:
    """Friction that changes by `c exp(-|qd|/v)`: peak near standstill (c > 0) or a law that flattens (c < 0)."""
    decay = fraction * top_rad_s

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(motion.sign[:, axis] * np.exp(-np.abs(motion.qd_rad_s[:, axis]) / decay))

    return MovingTerm(
        "velocity_friction",
        (axis,),
        (axis,),
        columns,
        ("stribeck_nm",),
        f"stribeck {fraction:g}",
        (("stribeck_velocity_rad_s", decay),),
    )


def power_friction(axis: int, exponent: float) -> MovingTerm:
    """Friction that grows with `|qd|^p sign(qd)`: 1/2 flattens, 2 steepens."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(motion.sign[:, axis] * np.abs(motion.qd_rad_s[:, axis]) ** exponent)

    name = {0.5: "root_nm_s05_rad05", 2.0: "square_nm_s2_rad2"}[exponent]
    return MovingTerm("velocity_friction", (axis,), (axis,), columns, (name,), f"power {exponent:g}")


def load_friction(axis: int) -> MovingTerm:
    """Gear losses in proportion to the torque passed on: `nu |tau| sign(qd)` (Hamon, Gautier, Garrec 2010)."""

    def columns(motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(np.abs(modelled.rigid_nm[:, axis]) * motion.sign[:, axis])

    return MovingTerm("load_dependent_friction", (axis,), (axis,), columns, ("coefficient",), modelled=True)


def together(first: MovingTerm, second: MovingTerm) -> MovingTerm:
    """Two effects of the same axes as one, to be tried at once where each alone hides behind the other."""

    def columns(motion: MovingRows, modelled: Modelled) -> Floats:
        return np.concatenate([first.columns(motion, modelled), second.columns(motion, modelled)], axis=2)

    return MovingTerm(
        first.name,
        first.joints,
        first.axes,
        columns,
        first.symbols + second.symbols,
        f"{first.shape} with {second.name} {second.shape}",
        modelled=first.modelled or second.modelled,
    )


# ---------------------------------------------------------------------------------------------------------- coupling


def axis_coupling(pair: tuple[int, int], coefficient: float) -> MovingTerm:
    """Motor j turns at `qd_j + c qd_i`: its friction and rotor inertia act on j, and `c` times on i."""
    i, j = pair

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        speed = motion.qd_rad_s[:, j] + coefficient * motion.qd_rad_s[:, i]
        acceleration = motion.qdd_rad_s2[:, j] + coefficient * motion.qdd_rad_s2[:, i]
        top = motion.speed_rad_s[j] + abs(coefficient) * motion.speed_rad_s[i]
        own = np.column_stack([smooth_sign(speed, top), speed, acceleration])
        return np.stack([coefficient * own, own], axis=1)

    return MovingTerm(
        "axis_coupling",
        pair,
        pair,
        columns,
        ("motor_coulomb_nm", "motor_viscous_nm_s_rad", "motor_inertia_kg_m2"),
        "motor",
        (("coefficient", coefficient),),
    )


def torque_mixing(pair: tuple[int, int]) -> MovingTerm:
    """Axis i is charged with a share of the whole torque of axis j: the motor's torque acts on both."""
    i, j = pair

    def columns(_: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(modelled.total_nm[:, j])

    return MovingTerm("axis_coupling", pair, (i,), columns, ("coefficient",), "mixing", modelled=True)


# --------------------------------------------------------------------------------------------------- springs, cables


def coil_balancer() -> MovingTerm:
    """Spring between link 2 and the base whose force grows with its length: `A sin(q2 - phase)`."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(np.cos(motion.q_rad[:, 1]), np.sin(motion.q_rad[:, 1]))

    return MovingTerm("balancer_spring", (1,), (1,), columns, ("cosine_nm", "sine_nm"), "coil")


def gas_balancer(phase_rad: float, stroke: float) -> MovingTerm:
    """Gas spring, shortest at q2 = phase: a polytropic force that rises with the stroke.

    The column is the law of a cylinder with lever and anchor `LEVER_M`, `ANCHOR_M`; `stroke` is the stroke at a quarter
    turn over the length of the gas column.
    """

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        angle = motion.q_rad[:, 1] - phase_rad
        length = np.sqrt(LEVER_M**2 + ANCHOR_M**2 - 2.0 * LEVER_M * ANCHOR_M * np.cos(angle))
        shortest, quarter = abs(ANCHOR_M - LEVER_M), np.hypot(LEVER_M, ANCHOR_M)
        used = np.clip(stroke * (length - shortest) / (quarter - shortest), 0.0, 0.95)
        return on_axis((1.0 - used) ** -POLYTROPIC * LEVER_M * ANCHOR_M * np.sin(angle) / length)

    fixed = (("phase_rad", phase_rad), ("stroke_ratio", stroke))
    return MovingTerm("balancer_spring", (1,), (1,), columns, ("force_n",), "gas", fixed)


def cable(axis: int, shape: str) -> MovingTerm:
    """Dress pack wound up by one wrist axis: linear in its angle, or the first harmonic."""

    def linear(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(motion.q_rad[:, axis])

    def harmonic(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(np.sin(motion.q_rad[:, axis]), np.cos(motion.q_rad[:, axis]))

    if shape == "linear":
        return MovingTerm("cable_torque", (axis,), (axis,), linear, ("stiffness_nm_rad",), shape)
    return MovingTerm("cable_torque", (axis,), (axis,), harmonic, ("sine_nm", "cosine_nm"), shape)


def ripple(axis: int, per_revolution: float) -> MovingTerm:
    """Torque that swings `per_revolution` times per turn of the joint."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        angle = per_revolution * motion.q_rad[:, axis]
        return on_axis(np.sin(angle), np.cos(angle))

    fixed = (("per_revolution", per_revolution),)
    return MovingTerm("torque_ripple", (axis,), (axis,), columns, ("sine_nm", "cosine_nm"), "", fixed)
