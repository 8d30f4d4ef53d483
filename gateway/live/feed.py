"""From the motion loop to the process of the page: what is measured out, a wish to stop back; nothing here waits."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from gateway.acquire.events import PoseDone, Progress
from gateway.errors import PlanRefused
from gateway.live.drawing import stage_of
from gateway.live.wire import HEAD, PER_AXIS, ROW, SHOWN, CommandOver, Ended, Happened, PoseSeen, ShownCell, pieces
from gateway.motion.observed_fields import fill
from gateway.motion.observer import MotionProgress, Observed, Scene
from gateway.motion.state import Phase, StateTracker
from gateway.motion.stops import StopKind, StoppedByPerson, StopRequest

#: Shortest time between two rows [s]: no screen shows more, and a loop of 1 kHz need not be asked so often.
ROW_S: Final = 0.0075
#: Shortest time between two words about how far a motion is [s].
WORD_S: Final = 0.1
#: Messages that wait for room; further ones are left out.
WAITING: Final = 64
#: How long the last word may take to reach the page once nothing moves any more [s].
FAREWELL_S: Final = 0.5
PHASES: Final = tuple(Phase)
DEAD_BUTTON: Final = (
    "the process of the live page has ended, and with it its stop button; start again, with or without --live"
)
_NUMBER_OF: Final = {phase: float(number) for number, phase in enumerate(PHASES)}


class Feed:
    """An observer that hands on what it sees, and a source of wishes to stop.

    Parameters
    ----------
    channel : socket.socket
        This end of `wire.pair_of_sockets`.
    clock : callable
        Monotonic time [s].

    Attributes
    ----------
    dropped : int
        Rows and messages that the page had no room for.
    gone : bool
        The process of the page has ended.
    """

    def __init__(self, channel: socket.socket, clock: Callable[[], float] = time.monotonic) -> None:
        self.dropped = 0
        self.gone = False
        self._channel, self._clock = channel, clock
        self._waiting: deque[list[bytes]] = deque()
        self._row = np.zeros(HEAD)
        self._state: StateTracker | None = None
        self._modelled: tuple[np.ndarray, ...] = ()
        self._followed: tuple[np.ndarray, ...] = ()
        self._unanswered = 0
        self._sent_s = self._told_s = self._progress_s = -math.inf
        self._presses = 0

    # -- what the motion loop tells ------------------------------------------------------------------------------------

    def began(self, scene: Scene) -> None:
        """Arms are about to be powered."""
        self.show(stage_of(scene), scene.state)

    def show(self, stage: ShownCell, state: StateTracker) -> None:
        """What is seen from now on, and who knows what it does."""
        self._state = state
        self._row = np.zeros(HEAD + PER_AXIS * sum(arm.axes for arm in stage.arms))
        self._followed = ()
        self._say(stage)

    def sampled(self, observed: Observed) -> None:
        """One SYNC: its row goes out unless one went out just before, or there is no room."""
        if self.gone:
            return
        samples = observed.samples
        for sample in samples:
            if not sample.complete:
                self._unanswered += 1
        self._modelled = observed.modelled_nm
        followed, self._followed = self._followed or observed.targets_rad, observed.targets_rad
        if self._waiting:
            self._flush()
        now_s = self._clock()
        if now_s - self._sent_s < ROW_S or self._state is None:
            return
        self._sent_s = now_s
        row, first = self._row, samples[0]
        row[:HEAD] = now_s, first.sync_index, first.time_s, _NUMBER_OF[self._state.state.phase], self._unanswered
        at, shown = HEAD, Observed(samples, followed, observed.modelled_nm)
        for arm in range(len(samples)):
            at = fill(row, at, shown, arm, SHOWN)
        self._send(ROW + row.tobytes())

    def reported(self, event: object) -> None:
        """Something was told; what only says how far it is, not more often than can be read."""
        now_s = self._clock()
        if isinstance(event, MotionProgress):
            if now_s - self._told_s < WORD_S:
                return
            self._told_s = now_s
        elif isinstance(event, Progress) and event.remaining_s > 0.0:
            if now_s - self._progress_s < WORD_S:
                return
            self._progress_s = now_s
        elif isinstance(event, PoseDone):
            self._say(PoseSeen(event, self._modelled[0]))
            return
        self._say(Happened(event))

    def ended(self, failure: BaseException | None) -> None:
        """The arms are no longer under power."""
        self._say(Ended("" if failure is None else str(failure) or type(failure).__name__))

    # -- who asks ------------------------------------------------------------------------------------------------------

    def pressed(self) -> StopRequest | None:
        """A wish to stop once the button was pressed; the second time by quick stop, as of a signal.

        A page whose process has ended has a dead button: that is a wish to stop along the path.
        """
        heard = b""
        if not self.gone:
            try:
                heard = self._channel.recv(16)
            except BlockingIOError:
                return None
            except OSError:
                heard = b""
        if not heard:
            self.gone = True
            return StopRequest(StopKind.ALONG_PATH, PlanRefused(DEAD_BUTTON))
        self._presses += 1
        kind = StopKind.ALONG_PATH if self._presses == 1 else StopKind.QUICK_STOP
        return StopRequest(kind, StoppedByPerson("stopped by the button of the live page"))

    def close(self, reason: str) -> None:
        """Say that the command is ending, and why; not in the motion loop."""
        self._say(CommandOver(reason))
        until_s = time.monotonic() + FAREWELL_S
        while self._waiting and not self.gone and time.monotonic() < until_s:
            time.sleep(0.01)
            self._flush()
        with contextlib.suppress(OSError):
            self._channel.close()

    # -- inside --------------------------------------------------------------------------------------------------------

    def _say(self, message: object) -> None:
        if self.gone:
            return
        if len(self._waiting) >= WAITING:
            self.dropped += 1
            return
        self._waiting.append(pieces(message))
        self._flush()

    def _flush(self) -> None:
        while self._waiting:
            message = self._waiting[0]
            while message:
                if not self._sent(message[0]):
                    return
                message.pop(0)
            self._waiting.popleft()

    def _send(self, row: bytes) -> None:
        if not self._sent(row):
            self.dropped += 1

    def _sent(self, datagram: bytes) -> bool:
        """Whether it went out; where it did not there is no room, or nobody."""
        try:
            self._channel.send(datagram)
        except BlockingIOError:
            return False
        except OSError:
            self.gone = True
            return False
        return True
