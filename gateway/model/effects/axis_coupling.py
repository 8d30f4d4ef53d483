"""Effect: a motor also turns with another joint, so that friction, inertia or torque of one axis appears on another.

Gear trains and linkages run within the wrist, through the upper arm to its first axis, and from axis 2 to axis 3 and on
to axis 4 (parallel links, cable drives). Several couplings add up: axis i shows its own torque and a share of each
other one. The weight of a parallelogram is not a coupling: the serial links span it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, Over, RestSetup, measured_axes
from gateway.model.motion import Modelled, MovingRows, smooth_sign
from gateway.model.rest import AlteredModel
from gateway.model.term import NAN, Named, Seen, Term, on_axis, plus, wrist
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Usual coupling ratios of gear trains, tried first.
COEFFICIENTS: Final = (-1.0, -0.5, 0.5, 1.0)
#: Smallest and largest share of one axis' torque that appears on another.
SMALLEST_SHARE: Final = 0.02
LARGEST_SHARE: Final = 2.5


@dataclass(frozen=True, slots=True)
class _Coupling(Term):
    """Coupling: joint `inner` turns the motor of joint `outer`, both from 0."""

    inner: int
    outer: int
    name: ClassVar[str] = "axis_coupling"

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.inner + 1, self.outer + 1)


@dataclass(frozen=True, slots=True)
class TorqueMixing(_Coupling):
    """Torque coupling: the inner axis shows `coefficient` times the whole torque of the outer one."""

    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.7,)
    modelled: ClassVar[bool] = True

    def enters(self, axes: int) -> tuple[int, ...]:
        return (self.inner,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        return replace(setting, coupling=plus(setting.coupling, (self.inner, self.outer), theta[0]))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return on_axis(modelled.total_nm[:, self.outer])

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        return bool(SMALLEST_SHARE < abs(value[0]) < LARGEST_SHARE)


@dataclass(frozen=True, slots=True)
class MotorCoupling(_Coupling):
    """Motor coupling: the outer motor turns at `qd_outer + c qd_inner`; its friction and rotor act on both joints.

    On the inner joint they act `c` times.
    """

    coefficient: float
    parameters: ClassVar[tuple[str, ...]] = ("motor_coulomb_nm", "motor_viscous_nm_s_rad", "motor_inertia_kg_m2")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN, NAN)
    is_common: ClassVar[bool] = True

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        i, j, c = self.inner, self.outer, self.coefficient
        speed = motion.qd_rad_s[:, j] + c * motion.qd_rad_s[:, i]
        acceleration = motion.qdd_rad_s2[:, j] + c * motion.qdd_rad_s2[:, i]
        top = motion.speed_rad_s[j] + abs(c) * motion.speed_rad_s[i]
        own = np.column_stack([smooth_sign(speed, top), speed, acceleration])
        return np.stack([c * own, own], axis=1)

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if at most one coefficient is significantly negative: motor friction dissipates energy."""
        return bool((value[:2] > -2.0 * std[:2]).all() and (value[:2] > 0).any())

    @property
    def form(self) -> Named:
        return {"coefficient": self.coefficient}


def _geared(axes: int) -> set[tuple[int, int]]:
    """Return the pairs within the wrist, and those of axes 2, 3 and 4.

    On the latter a parallel link carries both, or cables go from one axis to the next.
    """
    groups = wrist(axes), range(1, min(axes, 4))
    return {(inner, outer) for group in groups for inner in group for outer in group if inner < outer}


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    yield from (TorqueMixing(*pair) for pair in sorted(_geared(rows.axes)))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    """Return couplings of the outer motor to the inner joint; the reverse needs a train that reaches back."""
    neighbours = {(axis, axis + 1) for axis in range(motion.axes - 1)}
    moving = set(measured_axes(motion))
    for pair in sorted(neighbours | _geared(motion.axes)):
        if set(pair) <= moving:
            yield from (MotorCoupling(*pair, coefficient) for coefficient in COEFFICIENTS)
            yield TorqueMixing(*pair)


EFFECT: Final = Effect(
    name="axis_coupling",
    words="coupling between two axes",
    meaning="friction or torque of one axis in the motion of another",
    parameters=(
        "coefficient",
        "motor_coulomb_nm",
        "motor_viscous_nm_s_rad",
        "motor_inertia_kg_m2",
    ),
    over=Over.TORQUE,
    at_rest=_at_rest,
    in_motion=_in_motion,
)
