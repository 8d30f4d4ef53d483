"""Link between motion loop and page process: samples out, stop requests back. No call blocks."""

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
from gateway.motion.state import SAFE, Phase, StateTracker
from gateway.motion.stops import StopKind, StoppedByPerson, StopRequest

#: Least time between two samples [s], enough for a screen.
ROW_S: Final = 0.0075
#: Least time between two progress messages [s].
WORD_S: Final = 0.1
#: Number of queued messages; further ones are dropped.
WAITING: Final = 64
#: Time limit for the final message after the motion [s].
FAREWELL_S: Final = 0.5
PHASES: Final = tuple(Phase)
DEAD_BUTTON: Final = (
    "the process of the live page has ended, and with it its stop button; start again, with or without --live"
)
_NUMBER_OF: Final = {phase: float(number) for number, phase in enumerate(PHASES)}


class Feed:
    """Observer that forwards samples and events to the page, and a source of stop requests.

    Parameters
    ----------
    channel : socket.socket
        This end of `wire.pair_of_sockets`.
    clock : callable
        Monotonic time [s].

    Attributes
    ----------
    dropped : int
        Samples and messages dropped because the queue was full.
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

    # -- calls of the motion loop
    # ---------------------------------------------------------------------------------------

    def began(self, scene: Scene) -> None:
        """Report that arms are about to be enabled."""
        self.show(stage_of(scene), scene.state)

    def show(self, stage: ShownCell, state: StateTracker) -> None:
        """Register the observed arms."""
        self._state = state
        self._row = np.zeros(HEAD + PER_AXIS * sum(arm.axes for arm in stage.arms))
        self._followed = ()
        self._say(stage)

    def sampled(self, observed: Observed) -> None:
        """Send the sample of one SYNC, unless one was just sent or the queue is full."""
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
        """Forward an event; progress events at a limited rate."""
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
        """Report the end of a motion, and whether every drive was read as disabled."""
        disabled = self._state is None or self._state.state.phase in SAFE
        self._say(Ended("" if failure is None else str(failure) or type(failure).__name__, disabled))

    # -- who asks ------------------------------------------------------------------------------------------------------

    def pressed(self) -> StopRequest | None:
        """Return a stop request after the button was pressed; the second time a quick stop, as for a signal.

        If the page process has ended, its button does not work: this also requests a stop along the path.
        """
        received = b""
        if not self.gone:
            try:
                received = self._channel.recv(16)
            except BlockingIOError:
                return None
            except OSError:
                received = b""
        if not received:
            self.gone = True
            return StopRequest(StopKind.ALONG_PATH, PlanRefused(DEAD_BUTTON))
        self._presses += 1
        kind = StopKind.ALONG_PATH if self._presses == 1 else StopKind.QUICK_STOP
        return StopRequest(kind, StoppedByPerson("stopped by the button of the live page"))

    def close(self, reason: str) -> None:
        """Send the final message with the reason; not to be called in the motion loop."""
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
        """Return whether the datagram was sent; otherwise the queue is full or the page is closed."""
        try:
            self._channel.send(datagram)
        except BlockingIOError:
            return False
        except OSError:
            self.gone = True
            return False
        return True
