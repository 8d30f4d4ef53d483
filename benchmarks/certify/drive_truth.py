"""True timing of simulated drives, from what their connector carried and how their motors moved (`sim.timing_record`).

Nothing of the gateway is used here. The definitions are those of the how-to of `check --timing`. Standstill is the
first instant at which the speed in the direction of motion is below 2 % of the speed at the start of the stop.
The speed is that of the position which the encoder measures, differentiated over one simulated step.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

SYNC, RPDO1, TPDO1, MASTER_HEARTBEAT = 0x080, 0x200, 0x180, 0x77F
SWITCH_ON_DISABLED, ENABLED, FAULT_REACTION, FAULT = 0x40, 0x27, 0x0F, 0x08
#: SYNCs of a series at least, and the pause between two series [s].
SERIES, PAUSE_S = 100, 0.1
QUICK_STOP_WORD = 2
#: Speed of a stopped motor over that at which it began to stop.
REST_SHARE = 0.02
#: A gap between heartbeats of the master from which on they are withheld [s].
GAP_S = 0.4
#: Two stamps of one frame differ by less [s].
SAME_S = 0.0002
#: An axis is in motion above this speed [rad/s].
MOVING_RAD_S = 0.005


@dataclass(frozen=True, slots=True)
class TimingTruth:
    """Frames and motion of one drive.

    Attributes
    ----------
    frame_s, frame_id, frame_data : of the bus
    motion_s : of each simulated step [s]
    position_rad, speed_rad_s, state, powered : of this drive at each step
    node : node id
    filter_s : time constant of the filter of its torque word [s]
    """

    frame_s: np.ndarray
    frame_id: np.ndarray
    frame_data: np.ndarray
    motion_s: np.ndarray
    position_rad: np.ndarray
    speed_rad_s: np.ndarray
    state: np.ndarray
    powered: np.ndarray
    node: int
    filter_s: float

    def figures(self) -> dict[str, float]:
        """Return the true value of each figure that the record determines."""
        losses = self._losses()
        found = {
            "sync_to_tpdo_s": self._sync_to_tpdo(),
            "heartbeat_loss_to_standstill_s": self._loss(losses[0]) if losses else None,
            "fault_reaction_time_s": self._fault(),
        }
        found |= dict(zip(("quick_stop_time_s", "quick_stop_angle_rad"), self._quick_stop(), strict=True))
        return {name: value for name, value in found.items() if value is not None}

    def _of(self, identifier: int) -> np.ndarray:
        return self.frame_s[self.frame_id == identifier]

    def _state_at(self, at_s: np.ndarray) -> np.ndarray:
        return self.state[np.clip(np.searchsorted(self.motion_s, at_s) - 1, 0, None)]

    def _sync_to_tpdo(self) -> float | None:
        """Median over the first SYNCs 10 ms apart, until the first controlword."""
        sync_s, sent_s = self._of(SYNC), self._of(TPDO1 + self.node)
        for series in np.split(sync_s, np.flatnonzero(np.diff(sync_s) > PAUSE_S) + 1):
            changed = np.flatnonzero(self._state_at(series) != SWITCH_ON_DISABLED)
            series = series[: changed[0] if len(changed) else None]
            if len(series) >= SERIES and abs(np.median(np.diff(series)) - 0.01) < 0.001:
                regular = series[:-1][np.abs(np.diff(series) - 0.01) < 0.001]
                nearest = np.searchsorted(sent_s, regular)
                known = nearest < len(sent_s)
                return float(np.median(sent_s[nearest[known]] - regular[known])) if known.any() else None
        return None

    def _losses(self) -> list[float]:
        """Return the last heartbeat before each gap in which this drive was in motion."""
        beats = self._of(MASTER_HEARTBEAT)
        ends = beats[1:][np.diff(beats) > GAP_S]
        starts = beats[:-1][np.diff(beats) > GAP_S]
        return [float(a) for a, b in zip(starts, ends, strict=True) if self._moves(a, b)]

    def _moves(self, begin_s: float, end_s: float) -> bool:
        inside = (self.motion_s >= begin_s) & (self.motion_s <= end_s) & (self.powered > 0)
        return bool(inside.any() and np.abs(self.speed_rad_s[inside]).max() > MOVING_RAD_S)

    def _rest_after(self, index: int) -> int | None:
        """Return the step at which a motor that begins to stop at a step has stopped."""
        speed = self.speed_rad_s[index]
        if abs(speed) < MOVING_RAD_S:
            return None
        rest = np.flatnonzero(self.speed_rad_s[index:] * np.sign(speed) < REST_SHARE * abs(speed))
        return index + int(rest[0]) if len(rest) else None

    def _leaves_enabled(self, after_s: float) -> int | None:
        index = int(np.searchsorted(self.motion_s, after_s))
        left = np.flatnonzero((self.state[index:-1] == ENABLED) & (self.state[index + 1 :] != ENABLED))
        return index + int(left[0]) + 1 if len(left) else None

    def _loss(self, last_s: float) -> float | None:
        left = self._leaves_enabled(last_s)
        rest = None if left is None else self._rest_after(left)
        return None if rest is None else float(self.motion_s[rest] - last_s)

    def _fault(self) -> float | None:
        """Return the time from the first fault in motion until rest."""
        into = np.isin(self.state[1:], (FAULT_REACTION, FAULT)) & (self.state[:-1] == ENABLED)
        for index in np.flatnonzero(into) + 1:
            rest = self._rest_after(int(index))
            if rest is not None:
                return float(self.motion_s[rest] - self.motion_s[index])
        return None

    def _quick_stop(self) -> tuple[float | None, float | None]:
        words = self.frame_data[self.frame_id == RPDO1 + self.node]
        at_s = self._of(RPDO1 + self.node)
        is_stop = (words[:, 0].astype(int) | words[:, 1].astype(int) << 8) == QUICK_STOP_WORD
        for commanded_s in at_s[is_stop]:
            sync_s = self._of(SYNC)
            sync_s = sync_s[sync_s >= commanded_s]
            if not len(sync_s):
                break
            index = int(np.searchsorted(self.motion_s, sync_s[0] + SAME_S)) - 1  # the state that its TPDO shows
            enabled = index > 0 and self.state[index] == ENABLED
            rest = self._rest_after(index) if enabled else None
            if rest is not None:
                travel = np.abs(self.position_rad[index : rest + 1] - self.position_rad[index]).max()
                return float(self.motion_s[rest] - sync_s[0]), float(travel)
        return None, None


def read_truth(path: Path) -> list[TimingTruth]:
    """Return what a record holds of each drive."""
    with np.load(path) as record:
        motion = record["motion"]
        powered = motion[:, :, 2]
        steps = np.diff(record["simulated_s"], prepend=-1.0)[:, None]
        speed = np.diff(motion[:, :, 0], axis=0, prepend=motion[:1, :, 0]) / steps
        return [
            TimingTruth(
                record["frame_s"],
                record["frame_id"],
                record["frame_data"],
                record["motion_s"],
                motion[:, number, 0],
                speed[:, number],
                motion[:, number, 1],
                powered[:, number],
                node=int(node),
                filter_s=float(record["filter_s"][number]),
            )
            for number, node in enumerate(record["node"])
        ]
