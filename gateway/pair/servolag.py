"""What the joints lag behind their set points, given back while time along the path slows down."""

from __future__ import annotations

import numpy as np

from gateway.data.sample import ArmSample
from gateway.pair.transform import Floats

#: Servos whose lag was not seen well enough, and the slowest that is believed [s].
MOST_CONDITION, LONGEST_CATCHING_UP_S = 1e6, 0.3

Pair = tuple[Floats, Floats]
Samples = tuple[ArmSample, ...]


class ServoLag:
    """What the joints lag behind their set points is given back as time along the path slows down.

    On the way the lags are part of the relation: hands have yielded to them, functions were learned with them. An arm
    that slows down makes up for its lag, each joint its own, and would leave the relation by it. So set points stay
    behind the path by what the joints lag at full rate, as fast as the servos catch up. A servo with position gain
    1/tau and part of the speed fed forward lags by `e + tau e' = T u'`; T and tau are fitted to all that was seen of
    the way, and nothing is measured and answered in one SYNC.

    Parameters
    ----------
    dt_s : float
        SYNC period.
    lag_s : float
        Servo lag, for what changes between the beginning of the stop and its end.
    joints : int
        Of both arms.
    """

    def __init__(self, dt_s: float, lag_s: float, joints: int) -> None:
        self._dt_s, self._lag_s = dt_s, lag_s
        self._rate = self._full = 1.0
        self._sent: list[Floats] = []
        self._lag_rad = self._speed_rad_s = self._back_rad = np.zeros(joints)
        self._squares, self._products = np.zeros((2, 2)), np.zeros(2)

    @property
    def slower(self) -> bool:
        """Time along the path slows down."""
        return self._rate < self._full

    def slow_down(self, rate: float) -> None:
        """The rate of the set points that are due."""
        if not self.slower and rate >= self._rate:
            self._full = rate
        self._rate = rate

    def given_back(self, speed_rad_s: Floats) -> Floats:
        """By how much (J,) [rad] the set points stay behind, where the path has speeds (J,) at full rate."""
        full = self._lag_rad + self._lag_s * self._full * (speed_rad_s - self._speed_rad_s)
        goal = (1.0 - self._rate / self._full) * full
        self._back_rad = self._back_rad + self._dt_s / (self._dt_s + self.catching_up_s) * (goal - self._back_rad)
        return self._back_rad

    @property
    def catching_up_s(self) -> float:
        """tau - T of the servos [s]; 0 where the way has not shown it."""
        if np.linalg.cond(self._squares) > MOST_CONDITION:
            return 0.0
        lag_s, tau_s = np.linalg.solve(self._squares, self._products)
        return min(max(float(tau_s - lag_s), 0.0), LONGEST_CATCHING_UP_S)

    def take(self, sent: Pair, samples: Samples, speed_rad_s: Floats) -> None:
        """What was sent at this SYNC and measured at it: drives are on their way to what was sent before."""
        q_rad = np.concatenate([sample.q_rad for sample in samples])
        if not self.slower and len(self._sent) > 1 and not np.isnan(q_rad).any():
            before, last = self._sent
            lag = last - q_rad
            faster = np.stack([last - before, self._lag_rad - lag]) / self._dt_s
            self._squares += faster @ faster.T
            self._products += faster @ (0.5 * (lag + self._lag_rad))
            self._lag_rad, self._speed_rad_s = lag, speed_rad_s
        self._sent = [*self._sent[-1:], np.concatenate(sent)]
