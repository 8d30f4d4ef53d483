"""Servo lag of the joints: estimated, equalised between joints, and compensated while time along the path slows
down.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gateway.data.visit import ArmSample
from gateway.pair.transform import Floats

#: Bounds of a plausible servo lag [s].
MOST_CONDITION, LONGEST_CATCHING_UP_S = 1e6, 0.3
#: A lag is known once its standard deviation is this small [s]; number of correlated neighbouring rows.
KNOWN_S, CORRELATED_ROWS = 0.3e-3, 50
#: Time at the end of a trajectory over which the equalisation is removed [s].
ENDING_S = 0.2
#: Further from the others a lag is not made up for: a drive that is so slow is not tuned [s].
MAX_LAG_DIFFERENCE_S = 0.02

Pair = tuple[Floats, Floats]
Samples = tuple[ArmSample, ...]


class LagLaw:
    """Law by which each joint follows its setpoints, fitted to all observations.

    A servo with position gain 1/tau and part of the speed fed forward lags by `e + tau e' = T u'`. The integral over
    some SYNCs is fitted, because encoder differences of a slow joint are too coarse.

    Parameters
    ----------
    dt_s : float
        SYNC period.
    joints : int
        Of both arms.
    rows : int
        SYNCs that are taken together.

    Attributes
    ----------
    lag_rad : array of shape (J,)
        Last observed lag of the joints [rad].
    """

    def __init__(self, dt_s: float, joints: int, rows: int = 1) -> None:
        self._dt_s, self._equalised = dt_s, CORRELATED_ROWS + rows
        self._sent: Floats | None = None
        self.lag_rad = np.zeros(joints)
        self._sum = np.zeros(joints)
        #: Setpoint, lag and integral of the lag at the SYNCs before.
        self._before: deque[Floats] = deque(maxlen=rows)
        self._squares, self._products = np.zeros((joints, 2, 2)), np.zeros((joints, 2))
        self._size, self._rows = np.zeros(joints), 0

    def take(self, sent_rad: Floats, q_rad: Floats) -> None:
        """Take the targets (J,) sent at this SYNC, and the joint positions at it, which follow the targets before."""
        last = self._sent
        self._sent = sent_rad
        if last is None or np.isnan(q_rad).any():
            self._before.clear()
            return
        lag = last - q_rad
        self._sum = self._sum + 0.5 * self._dt_s * (lag + self.lag_rad)
        self.lag_rad = lag
        now = np.stack([last, lag, self._sum])
        if len(self._before) == self._before.maxlen:
            displacement, more, middle = now - self._before[0]
            faster = np.stack([displacement, -more], axis=1)
            self._squares += faster[:, :, None] * faster[:, None, :]
            self._products += faster * middle[:, None]
            self._size += middle**2
            self._rows += 1
        self._before.append(now)

    def skip(self) -> None:
        """Skip a SYNC without usable data."""
        self._sent = None
        self._before.clear()

    @property
    def together_s(self) -> tuple[float, float] | None:
        """T and tau [s] as if all joints had the same; None before they have moved."""
        squares = self._squares.sum(axis=0)
        if np.linalg.cond(squares) > MOST_CONDITION:
            return None
        lag_s, tau_s = np.linalg.solve(squares, self._products.sum(axis=0))
        return float(lag_s), float(tau_s)

    @property
    def each_s(self) -> Floats:
        """T and tau (J, 2) of each joint [s]; NaN where they are not known well enough."""
        laws = np.full((len(self._size), 2), np.nan)
        for joint, (squares, products) in enumerate(zip(self._squares, self._products, strict=True)):
            if np.linalg.cond(squares) > MOST_CONDITION:
                continue
            found = np.linalg.solve(squares, products)
            variance = self._equalised * max(self._size[joint] - found @ products, 0.0) / self._rows
            if variance * np.linalg.inv(squares)[0, 0] <= KNOWN_S**2:
                laws[joint] = found
        return laws


def lag_differences(laws_s: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Which joints (J,) are known, and how much longer (J,) each of them lags than all on average [s], 0 where unknown.

    `laws_s` are T and tau (J, 2). A servo that does not catch up with its setpoints, or whose lag differs too much from
    the others, does not follow this law.
    """
    lag, tau = laws_s[:, 0], laws_s[:, 1]
    known = (lag > 0.0) & (tau > lag)
    more = np.zeros(len(laws_s))
    if known.any():
        known = known & (np.abs(lag - np.median(lag[known])) <= MAX_LAG_DIFFERENCE_S)
        more[known] = lag[known] - lag[known].mean()
    return known, more


def equalised_targets(q_rad: Floats, laws_s: Floats, dt_s: float) -> Floats:
    """What has to be added (M, J) [rad] to targets (M, J) that begin at rest, so that all joints follow as one would.

    `u / p = (1 + (tau0 - T0) s) / (1 + tau0 s) * (1 + tau s) / (1 + (tau - T) s)`, where tau0 and T0 are means. The
    remainder at the end of the trajectory is removed towards its end.
    """
    ahead = np.zeros_like(q_rad)
    known, _ = lag_differences(laws_s)
    if not known.any():
        return ahead
    lag, tau = laws_s[known].mean(axis=0).tolist()
    for joint in np.flatnonzero(known):
        own_lag, own_tau = laws_s[joint].tolist()
        displacement = q_rad[:, joint] - q_rad[0, joint]
        equalised = _passed(_passed(displacement, tau - lag, tau, dt_s), own_tau, own_tau - own_lag, dt_s)
        ahead[:, joint] = equalised - displacement
    ending = min(round(ENDING_S / dt_s), len(ahead))
    ahead[-ending:] -= np.linspace(0.0, 1.0, ending)[:, None] ** 2 * ahead[-1]
    return ahead


def _passed(signal: Floats, over_s: float, under_s: float, dt_s: float) -> Floats:
    """A signal (M,) from rest through `(1 + over s) / (1 + under s)`, by the bilinear transform."""
    over, under = 2.0 * over_s / dt_s, 2.0 * under_s / dt_s
    return np.asarray(lfilter([1.0 + over, 1.0 - over], [1.0 + under, 1.0 - under], signal))


class ServoLag:
    """Compensation of the servo lag as time along the path slows down.

    In motion the lags are part of the relation: hands have yielded to them, functions were learned with them. An arm
    that slows down catches up, each joint by its own lag, and would leave the relation. Setpoints are therefore delayed
    by the lag at full rate, as fast as the servos catch up according to earlier observations; there is no feedback
    within one SYNC.

    Parameters
    ----------
    dt_s : float
        SYNC period.
    lag_s : float or array of shape (J,)
        Servo lag, for what changes between the beginning of the stop and its end.
    joints : int
        Of both arms.
    """

    def __init__(self, dt_s: float, lag_s: float | Floats, joints: int) -> None:
        self._dt_s, self._lag_s = dt_s, lag_s
        self._rate = self._full = 1.0
        self._law = LagLaw(dt_s, joints)
        self._speed_rad_s = self._back_rad = np.zeros(joints)

    @property
    def slower(self) -> bool:
        """Time along the path slows down."""
        return self._rate < self._full

    def slow_down(self, rate: float) -> None:
        """Set the rate of the next setpoints."""
        if not self.slower and rate >= self._rate:
            self._full = rate
        self._rate = rate

    def given_back(self, speed_rad_s: Floats) -> Floats:
        """Return the offset (J,) [rad] of the setpoints, where the path has speeds (J,) at full rate."""
        full = self._law.lag_rad + self._lag_s * self._full * (speed_rad_s - self._speed_rad_s)
        goal = (1.0 - self._rate / self._full) * full
        self._back_rad = self._back_rad + self._dt_s / (self._dt_s + self.catching_up_s) * (goal - self._back_rad)
        return self._back_rad

    @property
    def catching_up_s(self) -> float:
        """Return tau - T of the servos [s]; 0 where it was not estimated."""
        laws = self._law.together_s
        return 0.0 if laws is None else min(max(laws[1] - laws[0], 0.0), LONGEST_CATCHING_UP_S)

    def take(self, sent: Pair, samples: Samples, speed_rad_s: Floats) -> None:
        """Process setpoints and measured positions of a SYNC; the path has speeds (J,) at full rate [rad/s]."""
        q_rad = np.concatenate([sample.q_rad for sample in samples])
        if self.slower:
            self._law.skip()
            return
        self._law.take(np.concatenate(sent), q_rad)
        self._speed_rad_s = speed_rad_s
