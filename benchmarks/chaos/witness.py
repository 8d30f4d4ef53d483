"""Record of the drives of a simulation: true speeds, states, brakes, frames received."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import can
import numpy as np

from sim.server import BusServer
from sim.states import PdsState

#: Between two lines of the log at least [s].
STEP_S = 0.0008
#: A joint slower than this is at rest [rad/s]; one that is disabled faster coasts until its brake has closed.
REST_RAD_S = 0.02
#: A frame received: monotonic time, identifier, length, data.
FRAME = struct.Struct("<dIB8s")
#: States in which the drive gives torque.
ENERGISED = (PdsState.OPERATION_ENABLED, PdsState.QUICK_STOP_ACTIVE, PdsState.FAULT_REACTION_ACTIVE)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Of one bus, since the last time it was asked for.

    Attributes
    ----------
    limits_rad_s : speed limit of each axis
    time_s : monotonic time of each line, shape (n,)
    fastest_rad_s : largest true speed of each rotor since the line before, shape (n, axes)
    speed_rad_s : true speed at that time, shape (n, axes)
    energised, free : the drive gives torque, the brake is open; shape (n, axes)
    frames : (monotonic time of arrival, identifier, data) of everything received
    sync : SYNCs received since power-up
    """

    limits_rad_s: np.ndarray
    time_s: np.ndarray
    fastest_rad_s: np.ndarray
    speed_rad_s: np.ndarray
    energised: np.ndarray
    free: np.ndarray
    frames: list[tuple[float, int, bytes]]
    sync: int

    def share(self, since_s: float) -> float:
        """Largest true speed since a time, as a share of that axis's limit."""
        rows = self.fastest_rad_s[self.time_s > since_s]
        return float((rows / self.limits_rad_s).max()) if len(rows) else 0.0

    def last_s(self, rows: np.ndarray, since_s: float) -> float:
        """Time of the last line in which something held for an axis, `since_s` if it never did afterwards."""
        held = np.flatnonzero(rows.any(axis=1) & (self.time_s > since_s))
        return float(self.time_s[held[-1]]) if len(held) else since_s

    def ending(self, since_s: float) -> Ending:
        """How the axes came to their end after a time."""
        moves = (np.abs(self.speed_rad_s) > REST_RAD_S) & self.free
        dropped = self.energised[:-1] & ~self.energised[1:] & (self.time_s[1:] > since_s)[:, None]
        return Ending(
            rest_s=self.last_s(moves, since_s) - since_s,
            disabled_s=self.last_s(self.energised, since_s) - since_s,
            locked_s=self.last_s(self.free, since_s) - since_s,
            dropped_moving=int((dropped & moves[1:]).any(axis=0).sum()),
            over=not (self.energised[-1].any() or self.free[-1].any()) if len(self.time_s) else True,
        )

    def sent(self, identifier: int, since_s: float) -> list[tuple[float, bytes]]:
        """Frames of an identifier after a time."""
        return [(at, data) for at, number, data in self.frames if number == identifier and at > since_s]


@dataclass(frozen=True, slots=True)
class Ending:
    """How axes came to rest, from a certain instant on.

    Attributes
    ----------
    rest_s, disabled_s, locked_s : until the last one was at rest, gave no torque, was in its brake
    dropped_moving : axes that coasted: they were disabled before they were at rest
    over : all of that has happened
    """

    rest_s: float
    disabled_s: float
    locked_s: float
    dropped_moving: int
    over: bool

    def joined(self, other: Ending) -> Ending:
        """Of two arms: the later of each."""
        return Ending(
            max(self.rest_s, other.rest_s),
            max(self.disabled_s, other.disabled_s),
            max(self.locked_s, other.locked_s),
            self.dropped_moving + other.dropped_moving,
            self.over and other.over,
        )


class Witness:
    """Writes down what happens on one simulated bus; to be made before it runs.

    Parameters
    ----------
    server : the bus
    """

    def __init__(self, server: BusServer) -> None:
        self._server = server
        self._limits = np.array([drive.spec.speed_limit_rad_s for drive in server.drives])
        # flat: a list of objects that grows is walked by the garbage collector, and the drives stall meanwhile
        self._lines = array("d")
        self._frames = bytearray()
        self._last_s = 0.0
        self._pass: Callable[[float], None] = server.pass_until
        self._serve: Callable[[can.Message | None], None] = server.serve
        changed: Any = server
        changed.pass_until, changed.serve = self._passed, self._served

    def _passed(self, until_s: float) -> None:
        self._pass(until_s)
        now_s = self._server.real_at_s
        if now_s - self._last_s >= STEP_S:
            self._last_s = now_s
            self._note(now_s)

    def _note(self, now_s: float) -> None:
        axes = [drive.axis for drive in self._server.drives]
        lines = self._lines
        lines.append(now_s)
        lines.extend([axis.fastest_rad_s for axis in axes])
        lines.extend([axis.omega_rad_s for axis in axes])
        lines.extend([drive.automaton.state in ENERGISED for drive in self._server.drives])
        lines.extend([axis.free for axis in axes])
        for axis in axes:
            axis.fastest_rad_s = 0.0

    def _served(self, message: can.Message | None) -> None:
        if message is not None:
            age_s = time.time() - message.timestamp if message.timestamp else 0.0
            data = bytes(message.data)
            self._frames += FRAME.pack(time.monotonic() - age_s, message.arbitration_id, len(data), data)
        self._serve(message)

    @property
    def speed_rad_s(self) -> float:
        """Largest true speed of a joint now."""
        return max(abs(drive.axis.omega_rad_s) for drive in self._server.drives)

    @property
    def powered(self) -> bool:
        """Whether a drive gives torque now."""
        return any(drive.automaton.state in ENERGISED for drive in self._server.drives)

    def cut(self) -> Track:
        """The log so far; it begins afresh."""
        (lines, self._lines), (frames, self._frames) = (self._lines, array("d")), (self._frames, bytearray())
        axes = len(self._limits)
        rows = np.array(lines).reshape(-1, 1 + 4 * axes)
        fastest, speed, energised, free = np.split(rows[:, 1:], 4, axis=1)
        return Track(
            self._limits,
            rows[:, 0],
            fastest,
            speed,
            energised.astype(bool),
            free.astype(bool),
            frames=[(at, number, data[:length]) for at, number, length, data in FRAME.iter_unpack(frames)],
            sync=self._server.sync_count,
        )
