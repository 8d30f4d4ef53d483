"""Term: an effect at one location and in one form, for visits at rest and for samples in motion.

`theta` are the parameters of a term; those in which the torque is linear come first. At rest a term writes them to an
`AlteredModel`. In motion it returns torque columns in addition to the rigid bodies; its other parameters are fixed at
their start values. Both report the same parameters. A column never contains a measured torque, because the residual
would then explain itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from gateway.model.motion import Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Named = dict[str, float]
Label = tuple[str, tuple[int, ...]]

NAN = float("nan")
NO_BOUNDS: Mapping[str, tuple[float, float]] = {}


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Data of a moving run with which an effect checks its own plausibility.

    Attributes
    ----------
    motion : MovingRows
    modelled : Modelled
    drawn_nm : array of shape (n, N)
        Torque of the links of the robot model, 0 if they are unknown.
    friction_nm : function of (axis, columns (n, k), value (k,))
        Coulomb and viscous friction (n,) of an axis, refitted together with the effect, plus the effect [Nm].
    """

    motion: MovingRows
    modelled: Modelled
    drawn_nm: Floats
    friction_nm: Callable[[int, Floats, Floats], Floats]


@dataclass(frozen=True, slots=True)
class Term:
    """Effect at one location and in one form.

    Attributes
    ----------
    name : str
        Name of the effect in the result file.
    parameters : tuple of str
        Names of `theta`, with unit.
    linear : tuple of bool
        True for parameters in which the torque is linear; they come first.
    SPREAD : tuple of float
        Standard deviation of the prior about `start`; NaN = range that corresponds to ten noise floors.
    bounds : mapping
        Smallest and largest plausible value of reported parameters.
    modelled : bool
        True if the columns in motion depend on the modelled torque.
    is_common : bool
        True for a property of any gear: it needs less evidence than a fault or an additional part.
    scales_reading : bool
        True if the columns of the bodies are scaled by the fitted factor.
    with_friction : bool
        True if Coulomb and viscous friction of its axis are part of the report.
    takes_over : str
        Nuisance parameter of that axis that the effect replaces: "gain", "bias", "load_friction" or "cogging".
    looks_like : str
        Of a nuisance that is not fitted in every hypothesis: effect whose place it takes where it explains as much.
    """

    name: ClassVar[str] = ""
    parameters: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[tuple[bool, ...]] = (True,)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,)
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = NO_BOUNDS
    modelled: ClassVar[bool] = False
    is_common: ClassVar[bool] = False
    scales_reading: ClassVar[bool] = False
    with_friction: ClassVar[bool] = False
    takes_over: ClassVar[str] = ""
    looks_like: ClassVar[str] = ""

    @property
    def joints(self) -> tuple[int, ...]:
        """Joint numbers from 1; empty for the base and the load."""
        return ()

    @property
    def label(self) -> Label:
        """Name and joints of the effect for the reader; all forms of an effect share it."""
        return self.name, self.joints

    @property
    def start(self) -> tuple[float, ...]:
        """Start values of the parameters; 0 for linear ones."""
        return (0.0,) * len(self.linear)

    @property
    def spread(self) -> tuple[float, ...]:
        """Prior standard deviation of each parameter; NaN = not defined."""
        return self.SPREAD

    @property
    def tries(self) -> int:
        """Number of forms that were tested to find this one; its evidence is corrected for it."""
        return 1

    @property
    def count(self) -> int:
        """Number of linear parameters, which have a column each in motion."""
        return sum(self.linear)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        """Return the model with the effect."""
        raise NotImplementedError

    def switched(self) -> tuple[Term, float] | None:
        """For a change point: return the same effect as if always present, and the time [s] from which it acts."""
        return None

    def enters(self, axes: int) -> tuple[int, ...]:
        """Return the axes (from 0) whose torque the columns in motion affect."""
        return tuple(joint - 1 for joint in self.joints) or tuple(range(axes))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        """Return the torque (n, affected axes, linear parameters) [Nm] per unit of each parameter."""
        raise NotImplementedError

    def bodies(self, value: Floats, count: int) -> Floats:
        """Return the change of the link parameters (count,) by linear parameters (k,), or one 0."""
        return np.zeros(1)

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        """Return True if the mechanism is possible at rest; a spring that pushes instead of pulling is not."""
        return self.within_bounds(theta)

    def exists(self, theta: Floats, std: Floats) -> bool:
        """Return True if parameters (k,) at rest, within their standard deviations (k,), can belong to a real part."""
        return True

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if linear parameters (k,) with standard deviations (k,) are physically possible in motion."""
        return self.within_bounds(self.completed(value))

    def within_bounds(self, theta: Floats) -> bool:
        """Return True if the reported values of `theta` are within `bounds`."""
        if not self.bounds:
            return True
        values = self.reported(theta)
        return all(low < values[key] < high for key, (low, high) in self.bounds.items())

    def completed(self, value: Floats) -> Floats:
        """Return all parameters, with `value` for the linear ones."""
        return np.concatenate([value, np.array(self.start)[self.count :]])

    def shaped(self, values: Floats) -> Self:
        """Return the term with start values `values` for the nonlinear parameters."""
        return self

    @property
    def form(self) -> Named:
        """Reported parameters of the form itself, which are not fitted."""
        return {}

    def named(self, theta: Floats) -> Named:
        """Return the parameters that are reported for `theta`, without those of the form."""
        return dict(zip(self.parameters, theta.tolist(), strict=True))

    def reported(self, theta: Floats) -> Named:
        """Return all reported parameters by name."""
        return self.named(theta) | self.form

    def report(self, theta: Floats, covariance: Floats) -> tuple[Named, Named]:
        """Return reported parameters, and standard deviations to first order, by name."""
        step = 1e-6 * np.maximum(np.abs(theta), np.sqrt(np.maximum(np.diag(covariance), 0.0))) + 1e-12
        values = self.named(theta)
        slope = np.empty((len(values), len(theta)))
        for position in range(len(theta)):
            sides = [self.named(theta + sign * step * (np.arange(len(theta)) == position)) for sign in (1.0, -1.0)]
            slope[:, position] = (np.array(list(sides[0].values())) - np.array(list(sides[1].values()))) / 2.0
            slope[:, position] /= step[position]
        variance = np.einsum("ik,kl,il->i", slope, covariance, slope)
        std = dict(zip(values, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))
        return values | self.form, std


@dataclass(frozen=True, slots=True)
class OnAxis(Term):
    """Effect on one axis (from 0)."""

    axis: int

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.axis + 1,)


@dataclass(frozen=True, slots=True)
class AngleTorque(OnAxis):
    """Torque on one axis by joint angles, of a part beside the gear: the motor torque is lower by this amount.

    Where `in_reading`, it is an additional torque in the reading instead.
    """

    in_reading: ClassVar[bool] = False

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        """Return the torque (n, k) at joint angles (n, N) per unit of the linear parameters; the others are `fixed`."""
        raise NotImplementedError

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        torque = self.shape(rows.q_rad, theta[self.count :]) @ theta[: self.count]
        field = "offset_nm" if self.in_reading else "passive_nm"
        return replace(setting, **{field: plus(getattr(setting, field), (slice(None), self.axis), torque)})

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        torque = self.shape(motion.q_rad, np.array(self.start)[self.count :])[:, None, :]
        return torque if self.in_reading else -torque


def on_axis(*columns: Floats) -> Floats:
    """Return columns (n,) of one axis as (n, 1, k)."""
    return np.stack(columns, axis=1)[:, None, :]


def plus(values: Floats, index: object, change: Floats | float) -> Floats:
    """Return a copy of `values` with `change` added at `index`."""
    moved = values.copy()
    moved[index] += change  # type: ignore[index]
    return moved


def wrist(axes: int) -> tuple[int, ...]:
    """Return the last axes (from 0), which orient the tool: three of six."""
    return tuple(range(max(3, axes - 3), axes))
