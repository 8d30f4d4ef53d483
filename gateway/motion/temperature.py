"""Motor temperatures of an arm, read over SDO during a measurement without blocking the motion loop."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from drives.profile import Temperature
from drives.sdo import Posted, SdoClient
from gateway.motion.opening import OpenArm


class MotorTemperatures:
    """Motor temperatures: one value per axis and visit, requested one axis at a time.

    Parameters
    ----------
    axes : sequence of (SdoClient, Temperature) or None
        SDO client and temperature object of each drive; None = the drive has none.
    """

    def __init__(self, axes: Sequence[tuple[SdoClient, Temperature] | None]) -> None:
        self._axes = tuple(axes)
        self.begin()

    def begin(self) -> None:
        """Discard the values and request the temperature of each drive again."""
        self._read_c = np.full(len(self._axes), np.nan)
        self._open = deque(axis for axis, known in enumerate(self._axes) if known is not None)
        self._posted: Posted | None = None

    def poll(self) -> None:
        """Store the last answer and request the next drive; called once per SYNC, never waits."""
        if self._posted is not None and not self._posted.answered and time.monotonic() < self._posted.until_s:
            return
        if self._posted is not None:
            axis = self._open.popleft()
            known = self._axes[axis]
            if known is not None and self._posted.value is not None:
                self._read_c[axis] = self._posted.value * known[1].unit_c.value
            self._posted = None
        if self._open and (known := self._axes[self._open[0]]) is not None:
            client, temperature = known
            at = temperature.object
            self._posted = client.post(at.index, at.subindex, at.type)

    @property
    def read_c(self) -> np.ndarray:
        """Temperatures (N,) [deg C] read since `begin`; NaN where no answer has come."""
        return self._read_c.copy()


def motor_temperatures(opened: OpenArm) -> MotorTemperatures | None:
    """Return the temperatures of an arm; None where no profile names an object for them."""
    pairs = zip(opened.group.access, opened.profiles, strict=False)
    axes = [None if profile.temperature is None else (access.sdo, profile.temperature) for access, profile in pairs]
    return MotorTemperatures(axes) if any(axes) else None
