"""Nuisance parameters at rest, which are part of every hypothesis, and errors of the torque readings.

The reading of axis i is `(1 + g_i + c + s_io + s_o + (d_i + d) w(t)) tau_i`: its own error `g_i` is a nuisance
parameter. `GainChanges` models the common error `c` (a wrong voltage or rms convention, one batch of motors). It also
models the change `s` of occasion o (a run with one load) and the drift `d` with `w(t) = 1 - exp(-t / T)`. Every
occasion has a change of its own and none is the reference, so that a result does not depend on their order or number.
Magnets lose 0.04 % (SmCo) to 0.2 % (ferrite) of their flux per kelvin, so a motor that is 10 K warmer reads 0.4 to 2 %
more current for a torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.data.rows import Table, numbered
from gateway.identify.nuisance import (
    CHANGE_AXIS,
    CHANGE_COMMON,
    COMMON_SHARE,
    LOAD_FRICTION,
    LOAD_FRICTION_STD,
    UNEVEN_LOSS,
)
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.model.motion import MovingRows
from gateway.model.rest import AlteredModel, neutral
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Duration [s] of a table below which no drift is modelled.
_LONG_S: Final = 60.0
#: Factor on a standard deviation that must not count twice: its weight becomes a hundredth.
_HELD_ELSEWHERE: Final = 10.0
#: Standard deviation [Nm] of a bias that is zero.
_NO_BIAS_NM: Final = 1e-9
#: The next value of a field of the setting, from the present one, the parameter of every axis (N,), and the visits.
Change = Callable[[Floats, Floats, Visits], Floats]
COLD: Final = ("cold_fast", "cold_slow")


@dataclass(frozen=True, slots=True, eq=False)
class GainChanges:
    """Prior of the common gain, the changes by occasion (of each axis, then of all), and the drift, in this order.

    Attributes
    ----------
    relative : (N,) share of the common error that an axis has: its constant's standard deviation over the largest
    common_std : standard deviation of the common error at the axis of the least certain constant
    occasions : run and load of each occasion, in their order
    start_s : time of the first visit; NaN = no drift is modelled
    factor : on the standard deviation of every change
    """

    relative: Floats
    common_std: float
    occasions: tuple[tuple[str, ...], ...] = ()
    start_s: float = np.nan
    factor: float = 1.0

    @staticmethod
    def none(gain_std: Floats) -> GainChanges:
        """Return the prior without changes and drift, for constants with these standard deviations (N,)."""
        largest = float(gain_std.max())
        return GainChanges(gain_std / largest, math.sqrt(COMMON_SHARE) * largest)

    @staticmethod
    def of(rows: Visits, gain_std: Floats, factor: float = 1.0) -> GainChanges:
        """Build the prior from visits and standard deviations (N,) of constants; `factor` scales the usual changes."""
        order = np.argsort(rows.time_s, kind="stable") if np.isfinite(rows.time_s).all() else np.arange(len(rows))
        occasions, _ = occasions_of(rows.take(order))
        long = np.ptp(rows.time_s) > _LONG_S
        start_s = float(rows.time_s.min()) if long else np.nan
        return replace(GainChanges.none(gain_std), occasions=occasions, start_s=start_s, factor=factor)

    @property
    def axes(self) -> int:
        """Number of axes N."""
        return len(self.relative)

    @property
    def count(self) -> int:
        """Number of parameters E."""
        return len(self.std)

    @property
    def std(self) -> Floats:
        """Prior standard deviation (E,) of each parameter; the mean is 0."""
        drift = self._change(REST_MODEL.drift_axis) if np.isfinite(self.start_s) else []
        changes = np.array([*(self._change(CHANGE_AXIS) * len(self.occasions)), *drift])
        return np.append(self.common_std, self.factor * changes)

    def patterns(self, rows: Visits) -> Floats:
        """Contribution (n, N, E) of a unit of each parameter to the gain; an unknown occasion contributes nothing."""
        n, axes = len(rows), self.axes
        every = np.hstack([np.eye(axes), np.ones((axes, 1))])
        number, (present, at) = {name: k for k, name in enumerate(self.occasions)}, occasions_of(rows)
        own = np.array([number.get(name, -1) for name in present], dtype=int)[at]
        here = own[:, None] == np.arange(len(number))
        changes = (here[:, None, :, None] * every[:, None]).reshape(n, axes, -1)
        parts = [np.broadcast_to(self.relative[:, None], (n, axes, 1)), changes]
        if np.isfinite(self.start_s):
            warm = 1.0 - np.exp(-np.maximum(rows.time_s - self.start_s, 0.0) / REST_MODEL.drift_s)
            parts.append(warm[:, None, None] * every[None])
        return np.concatenate(parts, axis=2)

    def _change(self, own: float) -> list[float]:
        return [own] * self.axes + [CHANGE_COMMON]


def occasions_of(rows: Visits | Table | MovingRows) -> tuple[tuple[tuple[str, ...], ...], NDArray[np.int_]]:
    """Return run and load of each occasion in the order of the rows, and the occasion (n,) of each row."""
    return numbered(rows.run, rows.load)


@dataclass(frozen=True, slots=True)
class NuisanceKind:
    """One kind of nuisance parameters, with one parameter per axis.

    Attributes
    ----------
    name : str
    field : what of an `AlteredModel` it changes
    mean, std : prior of every axis; a standard deviation of None is that of the constants or friction bands
    change : value of that field where this parameter of every axis is larger by a step
    """

    name: str
    field: str
    mean: float
    std: float | None
    change: Change

    def raised(self, setting: AlteredModel, step: Floats, rows: Visits) -> AlteredModel:
        """Return the model with this parameter of each axis increased by a step (N,)."""
        return replace(setting, **{self.field: self.change(getattr(setting, self.field), step, rows)})


def _added(now: Floats, step: Floats, _: Visits) -> Floats:
    return now + step


def _colder(time_s: float) -> Change:
    """Apply a larger friction of a cold arm that decays with this time constant."""
    return lambda now, step, rows: now + left_of_cold(rows, time_s)[:, None] * step


#: Nuisance parameters in their order: gain error of the reading, bias by direction [Nm], friction over torque, how far
#: losses are those of one efficiency (0 to 1), and by how much friction is larger cold, as it fades fast and slowly.
#: To add one: an entry at the end.
NUISANCE_KINDS: Final = (
    NuisanceKind("gain", "gain", 0.0, None, lambda now, step, _: now * (1.0 + step)),
    NuisanceKind("bias", "bias_nm", 0.0, None, _added),
    NuisanceKind("load_friction", "load_friction", LOAD_FRICTION, LOAD_FRICTION_STD, _added),
    NuisanceKind("one_efficiency", "one_efficiency", 0.5, 0.5, _added),
    NuisanceKind("cold_fast", "band_gain", 0.0, REST_MODEL.cold, _colder(REST_MODEL.warm_fast_s)),
    NuisanceKind("cold_slow", "band_gain", 0.0, REST_MODEL.cold, _colder(REST_MODEL.warm_slow_s)),
)
KINDS: Final = tuple(kind.name for kind in NUISANCE_KINDS)


@dataclass(frozen=True, slots=True, eq=False)
class RestNuisance:
    """Prior of the nuisance parameters (K N + E,): by kind and then by axis, then those of `changes`.

    `constants` (N,) is the share of a gain's prior variance that is of its torque constant; the rest is of losses.
    `lost` (N,) is the loss over transmitted torque that half differences show: a fit begins there.
    """

    mean: Floats
    std: Floats
    constants: Floats
    changes: GainChanges
    lost: Floats

    def __post_init__(self) -> None:
        """Make the arrays read-only, because all hypotheses share the prior."""
        self.mean.flags.writeable = False
        self.std.flags.writeable = False

    @staticmethod
    def of(
        gain_std: Floats,
        bias_std_nm: Floats,
        lost: Floats,
        changes: GainChanges,
        measured: Sequence[bool] = (),
        friction: Floats | float = 0.0,
    ) -> RestNuisance:
        """Build the prior from the torque constants and the approach directions of the visits.

        Parameters
        ----------
        gain_std : array of shape (N,)
            Of the torque constants alone.
        bias_std_nm : array of shape (N,)
        lost : array of shape (N,)
            Loss over transmitted torque, as the half differences show it.
        changes : GainChanges
            What the gains have in common, and how they change.
        measured : sequence of bool
            Axes (N,) whose gain was measured on this arm, uneven losses included; empty = none.
        friction : array of shape (N,) or float
            Standard deviation of a share of the torque that friction adds in visits with unknown approach directions.
        """
        own = np.sqrt(1.0 - COMMON_SHARE) * gain_std
        gain = np.hypot(np.hypot(own, np.where(measured or False, 0.0, UNEVEN_LOSS * lost)), friction)
        by_data = {"gain": gain, "bias": bias_std_nm}
        std = [by_data[kind.name] if kind.std is None else np.full(len(gain), kind.std) for kind in NUISANCE_KINDS]
        mean = np.repeat([kind.mean for kind in NUISANCE_KINDS], len(gain))
        constants = (own / gain) ** 2
        return RestNuisance(
            np.append(mean, np.zeros(changes.count)), np.concatenate([*std, changes.std]), constants, changes, lost
        )

    def held_elsewhere(self, known: NDArray[np.bool_]) -> RestNuisance:
        """Return the prior without that of the gains and biases (2 N,) that a stored identification contains."""
        std = self.std.copy()
        std[: len(known)] *= np.where(known, _HELD_ELSEWHERE, 1.0)
        if known[: self.axes].any():
            std[self.common] *= _HELD_ELSEWHERE
        return replace(self, std=std)

    def with_bias(self, std_nm: Floats) -> RestNuisance:
        """Return the prior for differences between loads, in which these biases (N,) are left; 0 = it cancels."""
        std = self.std.copy()
        std[KINDS.index("bias") * self.axes :][: self.axes] = np.maximum(std_nm, _NO_BIAS_NM)
        return replace(self, std=std)

    def with_losses(self, value: Floats, std: Floats) -> RestNuisance:
        """Return the prior with the load friction (N,) of other visits; NaN = not known."""
        own = KINDS.index("load_friction") * self.axes + np.flatnonzero(np.isfinite(value))
        changed = self.mean.copy(), self.std.copy()
        for part, seen in zip(changed, (value, std), strict=True):
            part[own] = seen[np.isfinite(value)]
        return replace(self, mean=changed[0], std=changed[1])

    @property
    def axes(self) -> int:
        """Number of axes N."""
        return self.changes.axes

    @property
    def start(self) -> Floats:
        """Start values (K N + E,) of a fit."""
        out = self.mean.copy()
        out[KINDS.index("load_friction") * self.axes :][: self.axes] = self.lost
        return out

    @property
    def common(self) -> int:
        """Index of the gain that is common to all axes."""
        return len(KINDS) * self.axes

    def taken_over(self, terms: Sequence[Term]) -> NDArray[np.int_]:
        """Indices of parameters that effects replace."""
        places = [
            KINDS.index(term.takes_over) * self.axes + term.joints[0] - 1 if term.joints else self.common
            for term in terms
            if (term.takes_over in KINDS and len(term.joints) == 1) or (term.takes_over == "gain" and not term.joints)
        ]
        return np.array(places, dtype=int)


def nuisance_setting(rows: Visits, value: Floats, patterns: Floats) -> AlteredModel:
    """Model with the nuisance parameters (K N + E,) only; `patterns` are those of `GainChanges`."""
    by_axis, shared = np.split(value, [len(KINDS) * rows.axes])
    setting, changed = neutral(len(rows), rows.axes), {}
    for kind, values in zip(NUISANCE_KINDS, by_axis.reshape(len(KINDS), rows.axes), strict=True):
        now: Floats = changed.get(kind.field, getattr(setting, kind.field))
        changed[kind.field] = kind.change(now, values, rows)
    return replace(setting, **changed | {"gain": changed["gain"] + patterns @ shared})


def left_of_cold(rows: Visits, time_s: float) -> Floats:
    """Remaining share (n,) of the cold friction at each visit with this time constant; 1 at the first."""
    return np.exp(-(rows.time_s - rows.time_s.min()) / time_s)
