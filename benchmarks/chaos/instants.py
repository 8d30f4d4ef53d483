"""`commission` at a terminal, disturbed at random instants, prompts included, by the clock.

Two questions are put to each run. Did an axis give torque without a monitor, for longer than the drives need to notice
it and to stop? And was every sentence about the arm true of the drives at the time at which it was said?
"""

from __future__ import annotations

import random
import re
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.chaos.interrupting import GRACE_S, ramp_s
from benchmarks.chaos.programs import TRIES, Program, Stage, disturbed, small_stage
from benchmarks.chaos.witness import Track
from gateway.motion.opening import axis_setups
from sim.faults import fault_of

#: The master's own identifier of SYNC.
SYNC_ID = 0x080
#: What a person takes to answer [s].
ANSWER_S = (0.3, 4.0)
QUESTION = re.compile(r"\[y/N\]: |HANG LOAD (\w+)\n")
#: Sentences that say that no axis gives torque.
DISABLED = re.compile(r"every drive was read as disabled|in its brakes")
#: Output is read so often, and travels so long [s].
LATE_S = 0.05
LONGEST_S = 120.0
#: Of a run without a disturbance: from its start over both questions and both loads [s].
WINDOW_S = 40.0
NODES = range(1, 7)


def _begin(*kinds: str) -> Callable[[Program, Stage, random.Random, Path], None]:
    def act(_program: Program, stage: Stage, rng: random.Random, _folder: Path) -> None:
        node = rng.choice(NODES)
        for kind in kinds:
            stage.served.ask("begin", fault_of(kind, node=node, syncs=0))

    return act


def _signal(number: int) -> Callable[[Program, Stage, random.Random, Path], None]:
    return lambda program, _stage, _rng, _folder: program.send(number)


#: What happens at the instant.
CAUSES: dict[str, Callable[[Program, Stage, random.Random, Path], None]] = {
    "SIGINT": _signal(signal.SIGINT),
    "SIGTERM": _signal(signal.SIGTERM),
    "SIGHUP": _signal(signal.SIGHUP),
    "SIGKILL": _signal(signal.SIGKILL),
    "power cycle of a node": _begin("power_cycle"),
    "exchange of a node": _begin("power_cycle", "drive_exchanged"),
    "unplugged adapter": lambda _program, _stage, _rng, folder: (folder / "pulled").touch(),
    "second master": _begin("second_master_nmt"),
    "frozen page": lambda program, _stage, _rng, _folder: program.freeze("gateway.live"),
    "full disk": lambda program, _stage, _rng, _folder: program.fill_disk(),
}


@dataclass(slots=True)
class Seen:
    """What came of many disturbed runs.

    Attributes
    ----------
    runs, powered, asked : how many; of them, with an axis under power, with a question open at that instant
    again : run again: ended before, or this computer was busy
    unmonitored_s : longest time for which an axis gave torque without a SYNC of the master
    unmonitored, prompts, untrue : runs with more than the allowed time or left under power; with torque while a
        question was open; with a sentence that was not true
    sentences : that were compared with the drives
    complaints : in words
    """

    runs: int = 0
    powered: int = 0
    asked: int = 0
    again: int = 0
    unmonitored_s: float = 0.0
    unmonitored: int = 0
    prompts: int = 0
    untrue: int = 0
    sentences: int = 0
    complaints: list[str] = field(default_factory=list)


class Person:
    """Reads what the program says, and answers its questions after some time."""

    def __init__(self, program: Program, rng: random.Random) -> None:
        self._program, self._rng, self._read = program, rng, 0
        self._due: tuple[float, str] | None = None
        self.open: list[tuple[float, float]] = []
        self._since_s = 0.0

    @property
    def is_asked(self) -> bool:
        """Whether a question is open."""
        return self._due is not None

    def look(self) -> None:
        """Notice a new question; answer one for which the time has come."""
        said, now_s = self._program.said, time.monotonic()
        if self._due is None and (question := QUESTION.search(said, self._read)):
            self._read, self._since_s = question.end(), self._program.heard[-1][0]
            self._due = now_s + self._rng.uniform(*ANSWER_S), question[1] or "y"
        elif self._due is not None and now_s >= self._due[0]:
            self.open.append((self._since_s, time.monotonic()))
            self._program.type(self._due[1])
            self._due = None

    def left(self) -> None:
        """The program has ended: so has an open question."""
        if self._due is not None:
            self.open.append((self._since_s, self._program.heard[-1][0]))


def unmonitored(track: Track) -> float:
    """Longest time [s] for which an axis gave torque after the last SYNC, or before the first."""
    sync = np.array([at for at, number, _ in track.frames if number == SYNC_ID])
    energised = track.time_s[track.energised.any(axis=1)]
    if not len(energised):
        return 0.0
    if not len(sync):
        return float(np.ptp(energised))
    latest = np.searchsorted(sync, energised, side="right") - 1
    since = np.where(latest >= 0, sync[np.maximum(latest, 0)], energised[0])
    return float((energised - since).max())


def energised_in(track: Track, begin_s: float, end_s: float) -> bool:
    """Whether an axis gave torque in a time."""
    rows = (track.time_s >= begin_s) & (track.time_s <= end_s)
    return bool(track.energised[rows].any())


def disturb(count: int, seed: int = 1, period_s: float = 0.01, progress: Callable[[], None] = lambda: None) -> Seen:
    """Disturb a commissioning at so many random instants.

    Parameters
    ----------
    count : int
        Instants, shared by all causes.
    seed : int
        Of the instants.
    period_s : float
        SYNC period.
    progress : callable
        Called after each.
    """
    seen, rng = Seen(), random.Random(f"instants {seed}")
    causes = [list(CAUSES)[number % len(CAUSES)] for number in range(count)]
    rng.shuffle(causes)
    with tempfile.TemporaryDirectory(prefix="instants-") as name:
        folder = Path(name)
        with small_stage(folder / "small", period_s, shorter) as stage:
            kept = {path: path.read_bytes() for path in stage.state.rglob("*") if path.is_file()}
            for number, cause in enumerate(causes):
                for _ in range(TRIES):
                    shutil.rmtree(stage.state, ignore_errors=True)
                    for path, content in kept.items():  # what a killed run left of its ledger is another day's
                        path.parent.mkdir(parents=True, exist_ok=True)
                        path.write_bytes(content)
                    if _disturbed(cause, stage, folder, rng, f"run {number}", seen):
                        break
                progress()
    return seen


def shorter(text: str) -> str:
    """Edit of the cell: two poses and one to validate, loads mounted where the arm is."""
    text = re.sub(r"(?m)^validation = \d+", "validation = 1", re.sub(r"(?m)^count = \d+", "count = 2", text))
    return re.sub(r"(?m)^loading_rad = .*\n", "", text)


def _start(stage: Stage, folder: Path) -> tuple[Program, Path]:
    stage.served.ask("renew")
    out = Path(tempfile.mkdtemp(dir=folder))
    words = ["commission", stage.cell, "--load", "tool", "-o", out, "--live", "-v"]
    program = stage.run(out / "pulled", *words, typed=True, module="benchmarks.chaos.unplugged")
    stage.served.ask("logs")
    return program, out


def _disturbed(cause: str, stage: Stage, folder: Path, rng: random.Random, name: str, seen: Seen) -> bool:
    """One run; False where it has to be run again."""
    program, out = _start(stage, folder)
    person = Person(program, rng)
    program.wait_for(lambda: person.look() is not None, rng.uniform(0.5, WINDOW_S))
    if program.code is not None:
        program.end(1.0)
        seen.again += 1
        return False
    powered, asked = stage.served.ask("powered"), person.is_asked
    CAUSES[cause](program, stage, rng, out)
    program.wait_for(lambda: person.look() is not None, LONGEST_S)
    code = program.end(1.0)
    person.left()
    limit_s = stage_limit_s(stage)
    time.sleep(limit_s if cause in ("SIGKILL", "unplugged adapter") else LATE_S)
    (track,) = stage.served.ask("logs")
    said = program.said
    if cause not in ("SIGKILL", "unplugged adapter") and disturbed(said):
        seen.again += 1
        return False
    seen.runs += 1
    seen.powered += powered
    seen.asked += asked
    what = f"{name}, {cause}, {'powered' if powered else 'asked' if asked else 'disabled'}, exit code {code}"
    longest_s = unmonitored(track)
    seen.unmonitored_s = max(seen.unmonitored_s, longest_s)
    if longest_s > limit_s or track.energised[-1].any():
        seen.unmonitored += 1
        seen.complaints.append(
            f"{what}: {longest_s:.2f} s of torque without SYNC, {limit_s:.2f} s are allowed; at the end"
            f" {'energised' if track.energised[-1].any() else 'disabled'}: ...{said[-600:]}"
        )
    if any(energised_in(track, begin_s + LATE_S, end_s) for begin_s, end_s in person.open):
        seen.prompts += 1
        seen.complaints.append(f"{what}: an axis gave torque while a question was open: ...{said[-600:]}")
    false = [text for at_s, text in program.heard if DISABLED.search(text) and energised_in(track, at_s - LATE_S, at_s)]
    seen.sentences += sum(len(DISABLED.findall(text)) for _, text in program.heard)
    if false or code is None or "Traceback" in said:
        seen.untrue += 1
        seen.complaints.append(f"{what}: {false or said[-1500:]}")
    shutil.rmtree(out, ignore_errors=True)
    return True


def stage_limit_s(stage: Stage) -> float:
    """Time until drives have noticed the loss of the master, stopped, and closed their brakes [s]."""
    arm = stage.served.loaded.cell.arm[0]
    setups = axis_setups(stage.served.loaded, arm)
    consumer_ms = max(setup.profile.heartbeat.consumer_ms for setup in setups)
    return consumer_ms / 1000.0 + ramp_s(stage.cell) + GRACE_S
