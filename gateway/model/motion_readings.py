"""Effects of moving runs that change geometry, bodies or the reading of an axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import MovingRows, angle_derivative, tilt_derivative
from gateway.model.motion_terms import Modelled, MovingTerm, on_axis

Floats = NDArray[np.float64]


def _times(change: Floats, modelled: Modelled) -> Floats:
    """Torque (n, 6) that a changed regressor (n, 6, 60) gives with the link parameters of each row."""
    return np.einsum("nap,np->na", change, modelled.body)


def zero_offset(axis: int, motion: MovingRows) -> MovingTerm:
    """The joint stands `offset_rad` further than the encoder says."""
    change = angle_derivative(motion, axis)

    def columns(_: MovingRows, modelled: Modelled) -> Floats:
        return _times(change, modelled)[:, :, None]

    return MovingTerm("joint_zero_offset", (axis,), tuple(range(6)), columns, ("offset_rad",), modelled=True)


def elasticity(axis: int, motion: MovingRows) -> MovingTerm:
    """The link stands `compliance tau` behind the motor's angle."""
    change = angle_derivative(motion, axis)

    def columns(_: MovingRows, modelled: Modelled) -> Floats:
        return -(_times(change, modelled) * modelled.rigid_nm[:, [axis]])[:, :, None]

    return MovingTerm("joint_elasticity", (axis,), tuple(range(6)), columns, ("compliance_rad_nm",), modelled=True)


def base_tilt(motion: MovingRows) -> MovingTerm:
    """The base is turned about its x and y axes."""
    change = [tilt_derivative(motion, 0), tilt_derivative(motion, 1)]

    def columns(_: MovingRows, modelled: Modelled) -> Floats:
        return np.stack([_times(part, modelled) for part in change], axis=2)

    return MovingTerm("base_tilt", (), tuple(range(6)), columns, ("tilt_x_rad", "tilt_y_rad"), modelled=True)


def gain(axis: int) -> MovingTerm:
    """The torque constant of one axis is not what is stored: its whole torque is read in another scale."""

    def columns(_: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(modelled.rigid_nm[:, axis])

    return MovingTerm("torque_constant_scale", (axis,), (axis,), columns, ("reading",), modelled=True)


def offset(axis: int) -> MovingTerm:
    """A constant of one axis's reading."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        return on_axis(np.ones(len(motion)))

    return MovingTerm("torque_offset", (axis,), (axis,), columns, ("offset_nm",))


def drift(axis: int, per_kelvin: bool) -> MovingTerm:
    """Friction of one axis that changes with temperature, or with time where none was recorded."""

    def columns(motion: MovingRows, modelled: Modelled) -> Floats:
        cause = motion.temperature_c[:, axis] if per_kelvin else motion.time_s
        friction = modelled.total_nm[:, axis] - modelled.rigid_nm[:, axis]
        return on_axis(friction * (cause - cause.min()))

    return MovingTerm("thermal_drift", (axis,), (axis,), columns, ("per_k" if per_kelvin else "per_s",), modelled=True)


def link_mass(link: int) -> MovingTerm:
    """A body on one link: mass and first moment."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        return motion.rigid[:, :, 10 * link : 10 * link + 4]

    symbols = ("mass_kg", "first_moment_x_kg_m", "first_moment_y_kg_m", "first_moment_z_kg_m")
    return MovingTerm("link_mass", (link,), tuple(range(6)), columns, symbols)


def payload_shift(label: str) -> MovingTerm:
    """First moment of the load that moves in proportion to time."""

    def columns(motion: MovingRows, _: Modelled) -> Floats:
        here = (motion.load == label) * (motion.time_s - motion.time_s.mean())
        return motion.rigid[:, :, 51:54] * here[:, None, None]

    symbols = ("moment_rate_x_kg_m_s", "moment_rate_y_kg_m_s", "moment_rate_z_kg_m_s")
    return MovingTerm("payload_shift", (), tuple(range(6)), columns, symbols)
