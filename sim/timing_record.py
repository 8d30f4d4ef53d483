"""Record of what passed the connector of the drives and how their motors moved, for the scoring of timing figures.

The record holds no figure. Frames are stamped with the monotonic clock: a received one when the bus received it, a sent
one when it was handed to the bus. Motion is stored after every step of the simulation.
"""

from __future__ import annotations

import time
from array import array
from pathlib import Path
from typing import Any

import can
import numpy as np

from sim.server import BusServer, Unit, came_s


class TimingRecord:
    """Frames and motion of the drives of one bus.

    Parameters
    ----------
    server : its bus and its arms are observed from now on
    """

    def __init__(self, server: BusServer) -> None:
        self._server = server
        self._frames: list[tuple[float, int, bytes]] = []
        self._motion = array("d")
        receive, send = server.bus.recv, server.bus.send

        def recv(timeout: float | None = None) -> can.Message | None:
            message = receive(timeout)
            if message is not None and not message.is_error_frame:
                self._frames.append((came_s(message), message.arbitration_id, bytes(message.data)))
            return message

        def sent(message: can.Message, *arguments: Any) -> None:
            send(message, *arguments)
            self._frames.append((time.monotonic(), message.arbitration_id, bytes(message.data)))

        server.bus.recv, server.bus.send = recv, sent
        for unit in server.arms:
            unit.send = sent
            self._observe(unit)

    def _observe(self, unit: Unit) -> None:
        advance = unit.advance

        def observed(seconds: float) -> None:
            before_s = unit.world.time_s
            advance(seconds)
            if unit.world.time_s != before_s:
                self._sample()

        unit.advance = observed

    def _sample(self) -> None:
        self._motion.extend((self._server.real_at_s, self._server.arms[0].world.time_s))
        for drive in self._server.drives:
            axis = drive.axis
            row = (axis.position_rad, float(drive.automaton.state.value), float(axis.fed))
            self._motion.extend(row)

    def write(self, path: Path) -> None:
        """Write a NumPy archive.

        `frame_s`, `frame_id`, `frame_data` (8 bytes, padded with 0). `motion_s` (K,) and `simulated_s` (K,) are the
        same instants in real and simulated time. `motion` (K, drives, 3) with the encoder's position at the
        gear output [rad], statusword bits of the state, and whether the motor is powered; `node` (drives,), `filter_s`
        (drives,).
        """
        drives = self._server.drives
        rows = np.frombuffer(self._motion, dtype=float).reshape(-1, 2 + 3 * len(drives))
        data = np.array([list(each[2][:8].ljust(8, b"\0")) for each in self._frames], dtype=np.uint8)
        np.savez_compressed(
            path,
            frame_s=np.array([each[0] for each in self._frames]),
            frame_id=np.array([each[1] for each in self._frames], dtype=np.int32),
            frame_data=data.reshape(-1, 8),
            motion_s=rows[:, 0],
            simulated_s=rows[:, 1],
            motion=rows[:, 2:].reshape(len(rows), len(drives), 3),
            node=np.array([drive.node_id for drive in drives]),
            filter_s=np.array([float(drive.spec.profile["torque"].get("filter_s", 0.001)) for drive in drives]),
        )
