"""An effect in one place and shape, for visits at rest and for rows in motion.

`theta` are the parameters of a term, those that the torque is linear in first. At rest a term puts them into an
`AlteredModel`; in motion it gives columns of torque beside the rigid bodies, its other parameters held where they
begin. Both faces report the same parameters. A column never holds a measured torque: with one in it the residual
explains itself.
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
    """What the rows of a moving run show beside an effect, for it to judge whether it can be.

    Attributes
    ----------
    motion : MovingRows
    modelled : Modelled
    drawn_nm : array of shape (n, N)
        Torque of the links as they are drawn, 0 where nothing is known of them.
    friction_nm : function of (axis, columns (n, k), value (k,))
        Coulomb and viscous friction (n,) of an axis, refitted beside the effect, and the effect itself [Nm].
    """

    motion: MovingRows
    modelled: Modelled
    drawn_nm: Floats
    friction_nm: Callable[[int, Floats, Floats], Floats]


@dataclass(frozen=True, slots=True)
class Term:
    """One effect in one place and shape.

    Attributes
    ----------
    name : str
        Effect as the result file calls it.
    parameters : tuple of str
        Names of `theta`, with unit.
    linear : tuple of bool
        Whether the torque is linear in each; the linear ones come first.
    SPREAD : tuple of float
        Standard deviation of the prior about `start`; NaN = as far as ten noise floors reach.
    bounds : mapping
        What an arm can have, smallest and largest, of parameters that are reported.
    modelled : bool
        Whether the columns in motion depend on the modelled torque.
    ordinary : bool
        Whether any gear has it: it needs less evidence than a fault or an extra part.
    scales_reading : bool
        Whether the columns of the bodies are read in the scale that is fitted.
    with_friction : bool
        Whether Coulomb and viscous friction of its axis belong to what is reported.
    takes_over : str
        What every arm has on that axis and the effect is too much of: "gain", "bias", "load_friction" or "cogging".
    """

    name: ClassVar[str] = ""
    parameters: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[tuple[bool, ...]] = (True,)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,)
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = NO_BOUNDS
    modelled: ClassVar[bool] = False
    ordinary: ClassVar[bool] = False
    scales_reading: ClassVar[bool] = False
    with_friction: ClassVar[bool] = False
    takes_over: ClassVar[str] = ""

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints counted from 1; empty for the base and the load."""
        return ()

    @property
    def label(self) -> Label:
        """Name and joints: what a reader calls the effect. Shapes of one effect share it."""
        return self.name, self.joints

    @property
    def start(self) -> tuple[float, ...]:
        """Where the parameters begin; 0 for linear ones."""
        return (0.0,) * len(self.linear)

    @property
    def spread(self) -> tuple[float, ...]:
        """Plausible size of each parameter, NaN = no opinion."""
        return self.SPREAD

    @property
    def tries(self) -> int:
        """How many shapes were looked through for this one, which is paid for where it is weighed."""
        return 1

    @property
    def count(self) -> int:
        """Number of linear parameters, which have a column each in motion."""
        return sum(self.linear)

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        """The setting with the effect in it."""
        raise NotImplementedError

    def switched(self) -> tuple[Term, float] | None:
        """For a change point: the same effect as if it had always been there, and the time [s] from which it acts."""
        return None

    def enters(self, axes: int) -> tuple[int, ...]:
        """Axes, from 0, of an arm of so many whose torque the columns in motion enter."""
        return tuple(joint - 1 for joint in self.joints) or tuple(range(axes))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        """Torque (n, axes entered, linear parameters) [Nm] per unit of each parameter."""
        raise NotImplementedError

    def bodies(self, value: Floats, count: int) -> Floats:
        """What linear parameters (k,) add to the parameters (count,) of the links, or one 0."""
        return np.zeros(1)

    def plausible(self, theta: Floats, rows: Visits) -> bool:
        """Whether the mechanism can do that at rest: a spring that pushes where it should pull cannot."""
        return self.within_bounds(theta)

    def exists(self, theta: Floats, std: Floats) -> bool:
        """Whether parameters (k,) at rest, within their standard deviations (k,), can belong to a real part."""
        return True

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Whether linear parameters (k,) with their standard deviations (k,) mean something physical in motion."""
        return self.within_bounds(self.completed(value))

    def within_bounds(self, theta: Floats) -> bool:
        """Whether what is reported of `theta` is what an arm can have."""
        if not self.bounds:
            return True
        values, _ = self.report(theta, np.zeros((len(theta), len(theta))))
        return all(low < values[key] < high for key, (low, high) in self.bounds.items())

    def completed(self, value: Floats) -> Floats:
        """All parameters, of which the linear ones are `value`."""
        return np.concatenate([value, np.array(self.start)[self.count :]])

    def shaped(self, values: Floats) -> Self:
        """The member of the family whose parameters that are not linear begin at `values`."""
        return self

    def report(self, theta: Floats, covariance: Floats) -> tuple[Named, Named]:
        """Parameters and standard deviations by name."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return (
            dict(zip(self.parameters, theta.tolist(), strict=True)),
            dict(zip(self.parameters, std.tolist(), strict=True)),
        )


@dataclass(frozen=True, slots=True)
class OnAxis(Term):
    """An effect of one axis, counted from 0."""

    axis: int

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.axis + 1,)


@dataclass(frozen=True, slots=True)
class ReadingTorque(OnAxis):
    """A torque that the reading of one axis has too much."""

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        """Torque (n, k) at joint angles (n, N) per unit of the linear parameters, the others `fixed`."""
        raise NotImplementedError

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        torque = self.shape(rows.q_rad, theta[self.count :]) @ theta[: self.count]
        return replace(setting, offset_nm=plus(setting.offset_nm, (slice(None), self.axis), torque))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return self.shape(motion.q_rad, np.array(self.start)[self.count :])[:, None, :]


@dataclass(frozen=True, slots=True)
class PassiveTorque(OnAxis):
    """A torque that a part beside the gear exerts on one joint: the motor gives as much less."""

    def shape(self, q_rad: Floats, fixed: Floats) -> Floats:
        """Torque (n, k) at joint angles (n, N) per unit of the linear parameters, the others `fixed`."""
        raise NotImplementedError

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        torque = self.shape(rows.q_rad, theta[self.count :]) @ theta[: self.count]
        return replace(setting, passive_nm=plus(setting.passive_nm, (slice(None), self.axis), torque))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return -self.shape(motion.q_rad, np.array(self.start)[self.count :])[:, None, :]


def on_axis(*columns: Floats) -> Floats:
    """Columns (n,) of one axis as (n, 1, k)."""
    return np.stack(columns, axis=1)[:, None, :]


def plus(values: Floats, index: object, change: Floats | float) -> Floats:
    """A copy of `values` with `change` added at `index`."""
    moved = values.copy()
    moved[index] += change  # type: ignore[index]
    return moved


def propagated(convert: Callable[[Floats], Named], theta: Floats, covariance: Floats) -> tuple[Named, Named]:
    """What `convert` makes of parameters (k,), and its standard deviations to first order."""
    here = convert(theta)
    step = 1e-6 * np.maximum(np.abs(theta), np.sqrt(np.maximum(np.diag(covariance), 0.0))) + 1e-12
    slope = np.empty((len(here), len(theta)))
    for position in range(len(theta)):
        sides = [convert(theta + sign * step * (np.arange(len(theta)) == position)) for sign in (1.0, -1.0)]
        slope[:, position] = (np.array(list(sides[0].values())) - np.array(list(sides[1].values()))) / 2.0
        slope[:, position] /= step[position]
    variance = np.einsum("ik,kl,il->i", slope, covariance, slope)
    return here, dict(zip(here, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))


def wrist(axes: int) -> tuple[int, ...]:
    """The last axes, from 0, that turn the tool: three of six."""
    return tuple(range(max(3, axes - 3), axes))
