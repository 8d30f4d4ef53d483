"""Ramp of the offsets over time: up, down, and zero at once when a drive leaves OPERATION ENABLED."""

from __future__ import annotations

#: Tolerance so that rounding does not add a step.
_ROUNDING = 1e-9


class Ramp:
    """Gain between 0 and 1, updated once per SYNC.

    Parameters
    ----------
    period_s : float
        SYNC period.
    duration_s : float
        Time from 0 to 1.

    Attributes
    ----------
    gain : float
        Factor of the offsets.
    reason : str or None
        Reason why the offsets were switched off for good.
    """

    __slots__ = ("_quicker", "_share", "_step", "_wanted", "gain", "reason")

    def __init__(self, period_s: float, duration_s: float) -> None:
        self._step = min(period_s / duration_s, 1.0)
        self._share = 0.0
        self._wanted = 0.0
        self._quicker = 1.0
        self.gain = 0.0
        self.reason: str | None = None

    def rise(self) -> None:
        """Begin to raise the gain to 1."""
        self._wanted, self._quicker = 1.0, 1.0

    def fall(self, quicker: float = 1.0) -> None:
        """Begin to lower the gain to 0, faster than the duration by a factor."""
        self._wanted, self._quicker = 0.0, quicker

    @property
    def resting(self) -> bool:
        """Return True if the gain has reached its target."""
        return self._share == self._wanted

    def cut(self, reason: str) -> None:
        """Set the gain to zero at once and for good."""
        self._share = self._wanted = self.gain = 0.0
        self.reason = self.reason or reason

    def step(self, *, enabled: bool) -> float:
        """Return the gain of the next SYNC.

        Parameters
        ----------
        enabled : bool
            Every drive was in OPERATION ENABLED at the last SYNC.
        """
        if not enabled:
            self.cut("a drive is not in OPERATION ENABLED")
        if self.reason is None and self._share != self._wanted:
            left = self._wanted - self._share
            step = self._quicker * self._step * (1.0 + _ROUNDING)
            self._share = self._wanted if abs(left) <= step else self._share + (step if left > 0 else -step)
            self.gain = self._share * self._share * (3.0 - 2.0 * self._share)
        return self.gain
