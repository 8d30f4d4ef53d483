"""Nuisance parameters at rest, which are part of every hypothesis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.nuisance import COMMON_SHARE, UNEVEN_LOSS, NuisancePrior
from gateway.identify.rest.gain_changes import GainChanges
from gateway.identify.rest.rest_thresholds import REST_MODEL
from gateway.model.rest import AlteredModel, neutral
from gateway.model.term import Term
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Factor on a standard deviation that must not count twice: its weight becomes a hundredth.
_HELD_ELSEWHERE: Final = 10.0
#: Standard deviation [Nm] of a bias that is zero.
_NO_BIAS_NM: Final = 1e-9


#: The next value of a field of the setting, from the present one, the parameter of every axis (N,), and the visits.
Change = Callable[[Floats, Floats, Visits], Floats]


@dataclass(frozen=True, slots=True)
class NuisanceKind:
    """One kind of nuisance parameters, with one parameter per axis.

    Attributes
    ----------
    name : str
    field : what of an `AlteredModel` it changes
    prior : mean and standard deviation of an axis, from what the constants and the sides of visits say of all axes
    change : value of that field where this parameter of every axis is larger by a step
    """

    name: str
    field: str
    prior: Callable[[NuisancePrior], tuple[Floats | float, Floats | float]]
    change: Change

    def raised(self, setting: AlteredModel, step: Floats, rows: Visits) -> AlteredModel:
        """Return the model with this parameter of each axis increased by a step (N,)."""
        return replace(setting, **{self.field: self.change(getattr(setting, self.field), step, rows)})


def _added(now: Floats, step: Floats, _: Visits) -> Floats:
    return now + step


def _colder(time_s: float) -> Change:
    """Apply a larger friction of a cold arm that decays with this time constant."""
    return lambda now, step, rows: now + left_of_cold(rows, time_s)[:, None] * step


def _cold(_: NuisancePrior) -> tuple[float, float]:
    return 0.0, REST_MODEL.cold


#: Nuisance parameters in their order: gain error of the reading, bias by direction [Nm], friction over torque, how far
#: losses are those of one efficiency (0 to 1), and by how much friction is larger cold, as it fades fast and slowly.
#: To add one: an entry at the end.
NUISANCE_KINDS: Final = (
    NuisanceKind("gain", "gain", lambda prior: (0.0, prior.gain_std), lambda now, step, _: now * (1.0 + step)),
    NuisanceKind("bias", "bias_nm", lambda prior: (0.0, prior.bias_std_nm), _added),
    NuisanceKind(
        "load_friction", "load_friction", lambda prior: (prior.load_friction, prior.load_friction_std), _added
    ),
    NuisanceKind("one_efficiency", "one_efficiency", lambda _: (0.5, 0.5), _added),
    NuisanceKind("cold_fast", "band_gain", _cold, _colder(REST_MODEL.warm_fast_s)),
    NuisanceKind("cold_slow", "band_gain", _cold, _colder(REST_MODEL.warm_slow_s)),
)
KINDS: Final = tuple(kind.name for kind in NUISANCE_KINDS)
COLD: Final = ("cold_fast", "cold_slow")


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
        prior: NuisancePrior,
        gain_std: Floats,
        lost: Floats,
        changes: GainChanges,
        measured: Sequence[bool] = (),
        friction: Floats | float = 0.0,
    ) -> RestNuisance:
        """Build the prior from the torque constants and the approach directions of the visits.

        Parameters
        ----------
        prior : NuisancePrior
        gain_std : array of shape (N,)
            Of the torque constants alone.
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
        prior = replace(prior, gain_std=gain)
        mean, std = (
            np.concatenate([np.broadcast_to(kind.prior(prior)[part], gain.shape) for kind in NUISANCE_KINDS])
            for part in (0, 1)
        )
        return RestNuisance(
            np.append(mean, np.zeros(changes.count)), np.append(std, changes.std), (own / gain) ** 2, changes, lost
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
