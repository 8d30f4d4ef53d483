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
from gateway.live import wire
from gateway.live.drawing import shown_arm
from gateway.live.wire import CommandOver, Ended, Happened, PoseSeen, ShownCell
from gateway.motion.arms import Arms
from gateway.motion.observer import MotionProgress, Observed, Observer, fill
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import SAFE, Phase, StateTracker
from gateway.motion.stops import StopKind, StoppedByPerson, StopRequest
from gateway.motion.workspace import Workspace

#: Least time between two samples [s], enough for a screen.
ROW_S: Final = 0.0075
#: Least time between two progress messages [s].
WORD_S: Final = 0.1
#: Number of queued messages; further ones are dropped.
WAITING: Final = 64
#: Time limit for the final message after the motion [s].
FAREWELL_S: Final = 0.5
PHASES: Final = tuple(Phase)
#: Time between two heartbeat requests [s].
ASK_S: Final = 0.2
#: Largest share of the time between two calls of `Feed.pressed` that counts as time without an answer [s], at least
#: one SYNC period: for the rest the command was itself stalled, or it did not move the arm.
COUNTED_S: Final = 0.1
#: Time given to the process of the page to start; it counts as `COUNTED_S` does [s].
START_S: Final = 30.0
_NUMBER_OF: Final = {phase: float(number) for number, phase in enumerate(PHASES)}


class Feed(Observer):
    """Observer that forwards samples and events to the page, and a source of stop requests.

    Parameters
    ----------
    channel : socket.socket
        This end of `wire.pair_of_sockets`.
    clock : callable
        Monotonic time [s], in lockstep as well: the page process answers in real time, however fast the virtual clock
        of the bus advances.

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
        self._row = np.zeros(wire.HEAD)
        self._state: StateTracker | None = None
        self._modelled: tuple[np.ndarray, ...] = ()
        self._followed: tuple[np.ndarray, ...] = ()
        self._unanswered = 0
        self._sent_s = self._asked_s = self._looked_s = -math.inf
        self._progress_s: dict[type, float] = {}
        self._no_answer_s, self._counted_s = -START_S, COUNTED_S
        self._presses = 0

    # -- calls of the motion loop
    # ---------------------------------------------------------------------------------------

    def began(self, arms: Arms, workspaces: tuple[Workspace, ...], period_s: float, state: StateTracker) -> None:
        """Report that arms are about to be enabled."""
        pairs = zip(arms.members, workspaces, strict=True)
        self.show(ShownCell(tuple(shown_arm(arm.name, workspace) for arm, workspace in pairs), period_s), state)

    def show(self, stage: ShownCell, state: StateTracker) -> None:
        """Register the observed arms."""
        self._state = state
        self._row = np.zeros(wire.HEAD + wire.PER_AXIS * sum(arm.axes for arm in stage.arms))
        self._followed = ()
        self._counted_s = max(COUNTED_S, stage.period_s)
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
        row[: wire.HEAD] = now_s, first.sync_index, first.time_s, _NUMBER_OF[self._state.state.phase], self._unanswered
        at, shown = wire.HEAD, Observed(samples, followed, observed.modelled_nm)
        for arm in range(len(samples)):
            at = fill(row, at, shown, arm, wire.SHOWN)
        if not self._sent(wire.ROW + row.tobytes()):
            self.dropped += 1

    def reported(self, event: object) -> None:
        """Forward an event; progress events at a limited rate."""
        if isinstance(event, PoseDone):
            self._say(PoseSeen(event, self._modelled[0]))
            return
        if isinstance(event, MotionProgress) or (isinstance(event, Progress) and event.remaining_s > 0.0):
            now_s = self._clock()
            if now_s - self._progress_s.get(type(event), -math.inf) < WORD_S:
                return
            self._progress_s[type(event)] = now_s
        self._say(Happened(event))

    def ended(self, failure: BaseException | None) -> None:
        """Report the end of a motion, and whether every drive was read as disabled."""
        disabled = self._state is None or self._state.state.phase in SAFE
        self._say(Ended("" if failure is None else str(failure) or type(failure).__name__, disabled))

    # -- who asks ------------------------------------------------------------------------------------------------------

    def pressed(self) -> StopRequest | None:
        """Return a stop request after the button was pressed; the second time a quick stop, as for a signal.

        If the page process has ended or does not answer, its button does not work: this also requests a stop along the
        path. Received answers are read first. Time counts as far as this was called regularly.
        """
        while not self.gone:
            try:
                received = self._channel.recv(16)
            except BlockingIOError:
                break
            except OSError:
                received = b""
            self._no_answer_s, self.gone = 0.0, not received
            if received == wire.STOP:
                self._presses += 1
                kind = StopKind.ALONG_PATH if self._presses == 1 else StopKind.QUICK_STOP
                return StopRequest(kind, StoppedByPerson("stopped by the button of the live page"))
        now_s = self._clock()
        self._no_answer_s += min(now_s - self._looked_s, self._counted_s)
        self._looked_s = now_s
        if now_s - self._asked_s >= ASK_S and self._sent(wire.ASK):
            self._asked_s = now_s
        rule = ARM_RULES["page"]
        if not self.gone and self._no_answer_s < rule.limit:
            return None
        what = "has ended" if self.gone else f"has not answered for {rule.limit:g} s"
        dead = f"stopped: the process of the live page {what}, so its stop button does not work; {rule.advice}"
        return StopRequest(StopKind.ALONG_PATH, PlanRefused(dead))

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
        self._waiting.append(wire.pieces(message))
        self._flush()

    def _flush(self) -> None:
        while self._waiting:
            message = self._waiting[0]
            while message:
                if not self._sent(message[0]):
                    return
                message.pop(0)
            self._waiting.popleft()

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
