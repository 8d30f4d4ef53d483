"""The master's heartbeat after a stop that was commanded and is not confirmed."""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.chaos.processes import drives
from benchmarks.chaos.rig import with_real_pacing
from benchmarks.chaos.stalling import PATIENCE_S, RPDO1, SLOW_RAD_S, Recorder, short_visits, stops
from benchmarks.chaos.witness import Track
from sim.faults import fault_of

#: Cases in which a drive does not confirm that it stops: commands or answers no longer arrive, it has gone, it is deaf.
KINDS = ("rpdo_gone", "tpdo_gone", "node_killed", "nmt_stopped")
#: After this no heartbeat may go out [s].
DELAYED_AFTER_S = 0.2
HEARTBEATS = range(0x701, 0x780)


@dataclass(slots=True)
class Heartbeats:
    """What came of many stops that were not confirmed.

    Attributes
    ----------
    stops : how many were commanded
    delayed : of them, with a heartbeat later than `SILENT_AFTER_S` and a period after the stop word
    last_s : time from the stop word to the last heartbeat, of each
    """

    stops: int = 0
    delayed: int = 0
    last_s: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


def heartbeats_after_refused_stop(
    stops: int, period_s: float = 0.01, seed: int = 1, progress: Callable[[], None] = lambda: None
) -> Heartbeats:
    """Let a drive fail while the arm moves so that its stop cannot be confirmed, and listen to the bus.

    Parameters
    ----------
    stops : int
        How many.
    period_s : float
        SYNC period.
    seed : int
        Of drive, kind and instant.
    progress : callable
        Called after each.
    """
    result = Heartbeats()
    rng = random.Random(f"heartbeats {seed}")
    real = with_real_pacing(period_s)
    with tempfile.TemporaryDirectory(prefix="heartbeats-") as name:
        folder = Path(name)
        with drives(folder, lambda text: real(short_visits(text))) as served:
            for number in range(stops):
                kind = KINDS[number % len(KINDS)]
                recorder = Recorder(folder, served.bus)
                until_s = time.monotonic() + PATIENCE_S
                while served.ask("speed") < SLOW_RAD_S and time.monotonic() < until_s and not recorder.end:
                    time.sleep(0.01)
                    recorder.listen()
                served.ask("log")
                served.ask("arm", fault_of(kind, node=rng.randint(1, 6), syncs=0), rng.randint(1, 40))
                while not recorder.said and time.monotonic() < until_s and not recorder.end:
                    time.sleep(0.01)
                    recorder.listen()
                recorder.close()
                _judge(served.ask("log"), kind, period_s, result)
                served.ask("renew")
                progress()
    return result


def _judge(track: Track, kind: str, period_s: float, result: Heartbeats) -> None:
    words = [at for at, number, data in track.frames if number in range(RPDO1 + 1, RPDO1 + 7) and stops(data)]
    if not words:
        result.complaints.append(f"{kind}: the arm was not commanded to stop")
        return
    # what is sent to drives that are found and checked again does not answer this stop
    until_s = min((at for at, number, _ in track.frames if number == 0 and at > words[0]), default=float("inf"))
    beats = [at - words[0] for at, number, _ in track.frames if number in HEARTBEATS and at < until_s]
    last_s = max([0.0, *beats])
    result.stops += 1
    result.last_s.append(last_s)
    if last_s > DELAYED_AFTER_S + period_s:
        result.delayed += 1
        result.complaints.append(f"{kind}: a heartbeat {last_s:.3f} s after the stop word")
