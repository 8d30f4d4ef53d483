"""Content of the page: samples and events of the motion loop as JSON for the browser, events with severity and text."""

from __future__ import annotations

import json
import time
from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drives.cia402 import State, decode_state, describe
from gateway.acquire.events import Narrowed, PeriodDone, PoseDone, Progress, SampleRepeated, Started, VisitDone
from gateway.data.visit import following_error_rad
from gateway.live.feed import PHASES
from gateway.live.wire import HEAD, PER_AXIS, CommandOver, Ended, Happened, Heard, Hello, PoseSeen, ShownArm, ShownCell
from gateway.model.kinematics import link_frames
from gateway.model.robot import reach_m
from gateway.motion.observer import MotionProgress
from gateway.motion.state import Phase
from gateway.report import notation

Floats = NDArray[np.float64]
Json = dict[str, Any]

#: History for browsers opened later [s], and maximum of stored samples and events.
PAST_S: Final = 30.0
PAST_ROWS, PAST_EVENTS, PAST_POSES = 3000, 40, 200
#: Span over which speed is measured [s].
SPEED_SPAN_S: Final = 0.02
#: Digits behind the point: 10 urad, 10 urad/s, 0.1 mm, 0.01 mNm.
DIGITS: Final = 5
#: Drive states that indicate a fault.
FAILED: Final = frozenset({State.FAULT, State.FAULT_REACTION_ACTIVE})


@dataclass(slots=True)
class _ArmPast:
    """Samples of one arm: shown and new ones."""

    arm: ShownArm
    reported: deque[list[float | None]] = field(default_factory=lambda: deque(maxlen=PAST_ROWS))
    fresh: list[list[float | None]] = field(default_factory=list)
    where: deque[tuple[float, Floats]] = field(default_factory=lambda: deque(maxlen=64))
    q_rad: Floats | None = None
    status: Floats | None = None

    def take(self, time_s: float, row: Floats) -> None:
        """Store a sample of shape (PER_AXIS, N)."""
        q_rad, followed_rad, torque_nm, modelled_nm, self.status = row
        if self.where and time_s <= self.where[-1][0]:
            self.where.clear()
        while len(self.where) > 1 and self.where[1][0] <= time_s - SPEED_SPAN_S:
            self.where.popleft()
        first = self.where[0] if self.where else None
        self.where.append((time_s, q_rad))
        speed = np.full_like(q_rad, np.nan) if first is None else (q_rad - first[1]) / (time_s - first[0])
        values = np.concatenate(
            [[time_s], q_rad, speed, following_error_rad(followed_rad, q_rad), torque_nm, modelled_nm]
        )
        self.fresh.append(_plain(values))
        if not np.isnan(q_rad).any():
            self.q_rad = q_rad

    def frame(self) -> Json:
        """Return new samples and the posture of the arm."""
        rows, self.fresh = self.fresh, []
        self.reported += rows
        return {"rows": rows, **self.stands()}

    def stands(self) -> Json:
        """Return link frames and drive states, as far as known."""
        stands: Json = {}
        if self.q_rad is not None:
            frames = link_frames(self.arm.robot, self.q_rad[None])[0, :, :3, :]
            stands["frames"] = np.round(frames.reshape(len(frames), 12), DIGITS).tolist()
        if self.status is not None:
            stands["drives"] = [_drive(word) for word in self.status.tolist()]
        return stands

    def past(self) -> Json:
        """Return the stored history."""
        return {"rows": list(self.reported), **self.stands()}


def _drive(word: float) -> list[Any]:
    """Return the text of a drive state, and its severity."""
    if word != word:
        return ["no answer", "warn"]
    state = decode_state(int(word))
    grave = "fail" if state in FAILED else "plain" if state is State.OPERATION_ENABLED else "warn"
    return [describe(int(word)), grave]


def _plain(values: Floats) -> list[float | None]:
    rounded = np.round(values, DIGITS)
    listed: list[float | None] = rounded.tolist()
    return [None if value != value else value for value in listed] if np.isnan(rounded).any() else listed


class Show:
    """Complete content of the page, stored for browsers opened later.

    Parameters
    ----------
    hello : Hello
    """

    def __init__(self, hello: Hello) -> None:
        self._hello = hello
        self._scene: Json | None = None
        self._arms: list[_ArmPast] = []
        self._events: deque[Json] = deque(maxlen=PAST_EVENTS)
        self._poses: deque[Json] = deque(maxlen=PAST_POSES)
        self._new: list[Json] = []
        self._standing: Json = {"phase": "", "what": "", "left_s": None, "unanswered": 0, "sync": 0}
        self._changed = False
        #: Wall clock minus monotonic clock: a browser has the wall clock only.
        self._wall_s = time.time() - time.monotonic()
        self.over = ""

    def take(self, message: Floats | object) -> None:
        """Process a sample or a message of the motion loop."""
        if isinstance(message, np.ndarray):
            self._row(message)
        elif isinstance(message, ShownCell):
            self._arms = [_ArmPast(arm) for arm in message.arms]
            self._scene = {
                "arms": [
                    {
                        "name": arm.name,
                        "axes": arm.axes,
                        "reach_m": round(reach_m(arm.robot), 3),
                        "modelled": arm.modelled,
                        "assumed": list(arm.assumed),
                        "bodies": [
                            {
                                "link": body.link,
                                "points": np.round(body.points_m, 4).tolist(),
                                "faces": [list(f) for f in body.faces],
                            }
                            for body in arm.bodies
                        ],
                        "boxes": np.round(arm.boxes_m, 4).tolist(),
                        "speed_rad_s": _plain(arm.speed_rad_s),
                        "torque_nm": _plain(arm.torque_nm),
                        "following_error_rad": _plain(arm.following_error_rad),
                    }
                    for arm in message.arms
                ],
                "past_s": PAST_S,
            }
            self._new.append({"scene": self._scene})
        elif isinstance(message, PoseSeen):
            done = message.done
            modelled = self._arms[0].arm.modelled if self._arms else False
            residual_nm = np.array(done.gravity_nm) - message.modelled_nm if modelled else None
            pose = {
                "pose": done.pose,
                "load": notation.load(done.load),
                "band_nm": _plain(np.array(done.friction_band_nm)),
                "residual_nm": None if residual_nm is None else _plain(residual_nm),
            }
            self._poses.append(pose)
            self._new.append({"pose": pose})
            self._happened(done)
        elif isinstance(message, Happened):
            self._happened(message.event)
        elif isinstance(message, Ended):
            at_rest = Phase.STOPPED if message.reason else Phase.IN_BRAKES
            self._standing |= {"phase": str(at_rest if message.disabled else Phase.UNKNOWN), "what": ""}
            self._changed = True
            if message.reason:
                self._say(FAIL, message.reason)
        elif isinstance(message, CommandOver):
            self.end(message.reason)

    def end(self, reason: str) -> None:
        """Record the end of the command."""
        self.over = reason
        self._new.append({"over": reason})

    def news(self) -> list[str]:
        """Return the changes since the last call as JSON."""
        news, self._new = self._new, []
        if self._changed and self._scene is not None:
            self._changed = False
            news.append({"frame": {**self._standing, "arms": [arm.frame() for arm in self._arms]}})
        return [json.dumps(each, allow_nan=False, separators=(",", ":")) for each in news]

    def past(self) -> list[str]:
        """Return the content for a page that was just opened, as JSON."""
        reported: list[Json] = [{"hello": {"title": self._hello.title, "stops": self._hello.stops}}]
        if self._scene is not None:
            reported.append({"scene": self._scene})
            reported.append({"frame": {**self._standing, "arms": [arm.past() for arm in self._arms]}})
        reported += [{"event": event} for event in self._events]
        reported += [{"pose": pose} for pose in self._poses]
        if self.over:
            reported.append({"over": self.over})
        return [json.dumps(each, allow_nan=False, separators=(",", ":")) for each in reported]

    # -- inside --------------------------------------------------------------------------------------------------------

    def _row(self, row: Floats) -> None:
        sent_s, sync, time_s, phase, unanswered = row[:HEAD].tolist()
        at = HEAD
        for past in self._arms:
            end = at + PER_AXIS * past.arm.axes
            if end > len(row):  # of another cell than the one that is shown
                return
            past.take(time_s, row[at:end].reshape(PER_AXIS, past.arm.axes))
            at = end
        self._standing |= {
            "phase": str(PHASES[int(phase)]),
            "sync": int(sync),
            "unanswered": int(unanswered),
            "wall_ms": round(1e3 * (sent_s + self._wall_s), 1),
        }
        self._changed = True

    def _happened(self, event: object) -> None:
        if isinstance(event, MotionProgress):
            self._standing["what"] = event.what
        elif isinstance(event, Progress):
            self._standing |= {"what": event.what, "left_s": round(event.remaining_s, 1)}
            self._changed = True
        elif (said := saying(event)) is not None:
            self._say(*said)

    def _say(self, grave: str, text: str) -> None:
        event = {"at": f"{datetime.now(UTC):%H:%M:%S}", "grave": grave, "text": text}
        self._events.append(event)
        self._new.append({"event": event})


#: Severity of a line: information, warning, reason of a stop.
PLAIN, WARN, FAIL = "plain", "warn", "fail"


def saying(event: object) -> tuple[str, str] | None:
    """Return severity and text of an event.

    None for events that the page shows elsewhere, such as the reason of a stop.
    """
    if isinstance(event, Started):
        return (
            PLAIN,
            f"{notation.load(event.load)}: {event.visits} to be measured"
            if event.visits
            else "during the transfer motion",
        )
    if isinstance(event, SampleRepeated):
        axes = ", ".join(notation.axis(axis) for axis in event.axes)
        return WARN, f"SYNC {event.sync_index} not answered by {axes}; sample repeated"
    if isinstance(event, VisitDone):
        side = "from below" if event.direction > 0 else "from above"
        return PLAIN, f"pose {event.pose} measured {side}"
    if isinstance(event, PoseDone):
        return PLAIN, f"pose {event.pose} measured from both directions"
    if isinstance(event, PeriodDone):
        lost = event.incomplete_epochs
        what = f"'{event.name}', period {event.period}"
        return (WARN, f"{what}: {lost} SYNCs not answered") if lost else (PLAIN, f"{what}: done")
    if isinstance(event, Narrowed):
        return PLAIN, f"{notation.load(event.load)}, {event.text}"
    if isinstance(event, Heard):
        return event.grave, event.text
    return None
