"""The effects that a model of an arm at rest may lack, one frozen dataclass each.

An effect puts its parameters `theta` into an `AlteredModel`; `parameters` and `units` name them, `linear` says which of
them the torque is linear in, `start` is where the others begin (they are profiled out), `spread` is how large each may
plausibly be (standard deviation of its prior; NaN = as far as ten noise floors reach). `report` turns the fitted values
into the parameters an engineer reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.reading import AlteredModel, RestRows

Floats = NDArray[np.float64]
NAN = float("nan")


class Term(Protocol):
    """What the search needs of an effect."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]
    linear: ClassVar[tuple[bool, ...]]

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints counted from 1; empty for the base and the load."""
        ...

    @property
    def start(self) -> tuple[float, ...]:
        """Where the parameters begin; 0 for linear ones."""
        ...

    @property
    def spread(self) -> tuple[float, ...]:
        """Plausible size of each parameter, NaN = no opinion."""
        ...

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        """The setting with the effect in it."""
        ...

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        """Whether the mechanism can do that: a spring that pushes where it should pull cannot."""
        ...

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        """Parameters and standard deviations by name."""
        ...


@dataclass(frozen=True, slots=True)
class Plain:
    """What most effects share: linear parameters that start at 0 and are reported as they are."""

    name: ClassVar[str] = ""
    parameters: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[tuple[bool, ...]] = (True,)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,)

    @property
    def joints(self) -> tuple[int, ...]:
        return ()

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0,) * len(self.linear)

    @property
    def spread(self) -> tuple[float, ...]:
        return self.SPREAD

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return True

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        pairs = zip(self.parameters, theta, std, strict=True)
        listed = [(key, float(value), float(error)) for key, value, error in pairs]
        return {key: value for key, value, _ in listed}, {key: error for key, _, error in listed}


@dataclass(frozen=True, slots=True)
class OnAxis(Plain):
    """An effect of one axis, counted from 0."""

    axis: int

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.axis + 1,)


def plus(values: Floats, index: object, change: Floats | float) -> Floats:
    """A copy of `values` with `change` added at `index`."""
    moved = values.copy()
    moved[index] += change  # type: ignore[index]
    return moved
