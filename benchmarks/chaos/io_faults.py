"""Input and output that fail beside the motion: terminal, frame log, adapter, malformed frames, SDO answers.

Each fault begins at an instant of a run that is drawn from the seed. The run is the real one, in lockstep and in real
time; how the drives ended is read from the drives.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import Any

from benchmarks.chaos.judging import held_up
from benchmarks.chaos.remote import Remote
from benchmarks.chaos.rig import Rig, adapters
from benchmarks.chaos.scenarios import TRIES, short_plan
from drives.bus import SDO_ANSWER_BASE, BusSpec
from drives.realtime import RealTime
from gateway.acquire.events import Started
from gateway.acquire.run_loop import Run, rest_visits
from gateway.acquire.visit_store import MemoryStore
from gateway.commands.console import Session
from gateway.motion.opening import frame_log_watched, open_arm
from gateway.motion.stops import StopDesk
from gateway.motion.stream import MoveOptions
from sim.server import ABANDONED_S
from sim.states import PdsState

#: After the start of the run, in SYNCs.
BEGINS = (40, 200)
#: Share of the receptions that a malformed frame takes.
MALFORMED_SHARE = 0.02
#: Share of the SDO answers that are lost, of one node never two in a row.
LOST_SHARE = 0.3
#: Longest time after which drives without a heartbeat have stopped [s]; in lockstep they wait for SYNC longer.
NO_PROGRESS_S = {"real": 1.5, "lockstep": ABANDONED_S + 3.0}
KINDS = ("frozen terminal", "failing frame log", "adapter unplugged", "malformed frames", "lost SDO answers")
GOES_ON = frozenset({"frozen terminal", "malformed frames", "lost SDO answers"})


class Broken:
    """The adapter of a bus with one of the faults, from an instant on.

    Attributes
    ----------
    touched : frames and calls that the fault has touched
    """

    def __init__(self, kind: str, rng: random.Random) -> None:
        self._lost: dict[int, bool] = {}
        self._kind, self._rng, self.touched = kind, rng, 0
        self._adapter: Any = None
        self._on: Callable[[], bool] = lambda: False

    def take(self, adapter: Any) -> Broken:
        self._adapter = adapter
        return self

    def begin_where(self, has_begun: Callable[[], bool]) -> None:
        self._on = has_begun

    def send(self, frame: Any, timeout: float | None = None) -> None:
        if self._kind == "adapter unplugged" and self._on():
            self.touched += 1
            raise OSError(19, "No such device")
        self._adapter.send(frame, timeout)

    def recv(self, timeout: float | None = None) -> Any:
        if not self._on():
            return self._adapter.recv(timeout)
        if self._kind == "adapter unplugged":
            self.touched += 1
            raise OSError(5, "Input/output error")
        if self._kind == "malformed frames" and self._rng.random() < MALFORMED_SHARE:
            self.touched += 1
            raise ValueError("invalid literal for int() with base 16: '1?8'")
        frame = self._adapter.recv(timeout)
        answer = frame is not None and SDO_ANSWER_BASE < frame.arbitration_id < SDO_ANSWER_BASE + 128
        if self._kind == "lost SDO answers" and answer:
            before = self._lost.get(frame.arbitration_id, False)
            self._lost[frame.arbitration_id] = lost = not before and self._rng.random() < LOST_SHARE
            self.touched += lost
            return None if lost else frame
        return frame

    def shutdown(self) -> None:
        self._adapter.shutdown()
        if self._kind == "adapter unplugged" and self._on():
            raise OSError(5, "Input/output error")


def play(drives: Rig | Remote, kind: str, seed: int) -> tuple[list[str], bool]:
    """One fault; what was not as stated, and whether the machine was stalled meanwhile."""
    drives.renew()
    rng = random.Random(f"{kind} {seed}")
    bus = drives.loaded.cell.bus[drives.loaded.cell.arm[0].bus]
    pacing = bus.pacing
    error: BaseException | None = None
    broken = Broken(kind, rng)
    store, desk, planned = MemoryStore(), StopDesk(), 0
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if kind == "frozen terminal":  # its other end is not read before the run is over
            master, slave = os.openpty()
            stack.callback(os.close, master)
            stderr, sys.stderr = sys.stderr, stack.enter_context(os.fdopen(slave, "w"))
            stack.callback(setattr, sys, "stderr", stderr)
            session = Session(verbosity=2)
            outlet: Any = session.console(err=True).file
            detached = outlet.detached()
            detached.__enter__()
        trace = folder / "trace.log"
        trace.symlink_to("/dev/full")
        options = {"trace": trace} if kind == "failing frame log" else {}
        with suppress(KeyboardInterrupt):
            try:
                spec = BusSpec.parse(drives.bus)
                with adapters(broken.take), open_arm(drives.loaded, spec, **options) as opened:
                    desk.watch(frame_log_watched(opened))

                    def listen(event: object) -> None:
                        if isinstance(event, Started):
                            begins = opened.group.sync_index + rng.randint(*BEGINS)
                            broken.begin_where(lambda: opened.group.sync_index >= begins)
                        if kind == "frozen terminal":
                            for _ in range(20):
                                session.note(f"{event} {'-' * 200}")

                    run = Run(opened.arm, opened.workspace, store, (listen,), MoveOptions(desk), pacing)
                    plan = short_plan(opened, seed)
                    planned = len(plan.visits)
                    run.execute(rest_visits(plan, opened.arm, opened.workspace), "none")
            except Exception as raised:
                error = raised
        shown, unwritten = b"", kind == "frozen terminal"
        if unwritten:
            os.set_blocking(master, False)
            leaving = threading.Thread(target=detached.__exit__, args=(None, None, None))
            leaving.start()
        while unwritten:
            unwritten = leaving.is_alive()
            with suppress(BlockingIOError):
                while True:  # a terminal gives a few KiB at a time
                    shown += os.read(master, 1 << 16)
    until_s = time.monotonic() + NO_PROGRESS_S[pacing]  # drives without a master stop by themselves
    while PdsState.OPERATION_ENABLED in drives.watched().states and time.monotonic() < until_s:
        time.sleep(0.05)
    watched = drives.watched()
    complaints = judge(
        kind,
        error,
        (len(store.visits), planned),
        watched.states,
        (broken.touched, b"lines were dropped" in shown),
    )
    if kind != "adapter unplugged":
        complaints += [
            "the master's heartbeat was missed" for state in watched.states if state is PdsState.FAULT_REACTION_ACTIVE
        ]
    busy = held_up(watched, bus.sync_period_s, bus.pacing)
    drives.renew()
    return complaints, busy


def judge(
    kind: str,
    error: BaseException | None,
    visits: tuple[int, int],
    states: tuple[PdsState, ...],
    seen: tuple[int, bool],
) -> list[str]:
    """What is not as the safety page states."""
    complaints: list[str] = []
    touched, dropped = seen
    if any(state is PdsState.OPERATION_ENABLED for state in states):
        complaints.append(f"drives are left in {[state.name for state in states]}")
    if kind in GOES_ON:
        if error is not None:
            complaints.append(f"the run ended: {type(error).__name__}: {error}")
        elif visits[0] != visits[1]:
            complaints.append(f"{visits[0]} of {visits[1]} visits")
    elif kind == "failing frame log":
        if not isinstance(error, OSError) or "frame log is incomplete" not in str(error):
            complaints.append(f"instead of the failure of the log: {type(error).__name__}: {error}")
    elif getattr(error, "exit_code", None) != 4:
        complaints.append(f"instead of a bus error: {type(error).__name__}: {error}")
    if kind != "failing frame log" and kind != "frozen terminal" and not touched:
        complaints.append("the fault touched nothing")
    if kind == "frozen terminal" and not dropped:
        complaints.append("the terminal took everything")
    return complaints


def play_again(drives: Rig | Remote, kind: str, seed: int) -> tuple[list[str], int]:
    """`play`, again where the machine was stalled; what was not as stated, and how often it was begun again."""
    real = drives.loaded.cell.bus[drives.loaded.cell.arm[0].bus].pacing == "real"
    for tries in range(TRIES):
        with RealTime() if real else nullcontext():
            complaints, busy = play(drives, kind, seed)
        if not complaints or not busy:
            return complaints, tries
    return complaints, TRIES - 1
