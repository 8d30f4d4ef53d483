"""Every command that moves, interrupted by a person, a system, a terminal that goes away or a disk that is full."""

from __future__ import annotations

import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

from benchmarks.chaos.killing import finished_on_disk
from benchmarks.chaos.programs import (
    COMMANDS,
    PAIR_PERIOD_S,
    POWER_S,
    TRIES,
    Command,
    Program,
    Stage,
    disturbed,
    pair_bus,
    pair_stage,
    prove,
    small_stage,
    teach,
)
from benchmarks.chaos.witness import Ending, Track
from gateway.cell.config import load_cell
from gateway.errors import InputError

#: Beyond the ramp, until brakes are on [s].
GRACE_S = 1.0
STOPPED, BUS, INPUT, DONE = 130, 4, 3, 0
#: Between a signal and its repetition [s].
AGAIN_S = (0.02, 0.4)
#: One run in so many is interrupted before its axes are under power.
EARLY_SHARE = 0.1

#: What happens to a program.
Action = Callable[[Program, random.Random], None]


def _twice(program: Program, rng: random.Random) -> None:
    program.send(signal.SIGINT)
    time.sleep(rng.uniform(*AGAIN_S))
    if program.code is None:
        program.send(signal.SIGINT)


ACTIONS: dict[str, Action] = {
    "SIGINT": lambda program, _: program.send(signal.SIGINT),
    "SIGINT twice": _twice,
    "SIGTERM": lambda program, _: program.send(signal.SIGTERM),
    "SIGHUP": lambda program, _: program.send(signal.SIGHUP),
    "closed stdout and stderr": lambda program, _: program.leave(),
    "full disk": lambda program, _: program.fill_disk(),
}


@dataclass(slots=True)
class Interruptions:
    """What came of many interrupted commands.

    Attributes
    ----------
    runs, powered : how many; of them, with axes under power at that instant
    early, disturbed : ended by themselves before it happened, or because this computer was busy, and were run again
    commands : runs by command
    delayed, dropped, unsafe, lost, codes : runs that were not at rest, disabled and in their brakes in time. Runs in
        which an axis was disabled in motion; that did not end there at all; that lost finished work; with an
        undocumented exit code
    longest_s : until the brakes were closed
    """

    runs: int = 0
    powered: int = 0
    early: int = 0
    disturbed: int = 0
    commands: dict[str, int] = field(default_factory=dict)
    delayed: int = 0
    dropped: int = 0
    unsafe: int = 0
    lost: int = 0
    announced: int = 0
    codes: int = 0
    longest_s: float = 0.0
    complaints: list[str] = field(default_factory=list)


def ramp_s(cell: Path) -> float:
    """Longest time in which an axis comes to rest inside its acceleration and jerk limits [s]."""
    axes = [axis for arm in load_cell(cell).cell.arm for axis in arm.axis]
    return max(
        axis.speed_limit_rad_s / axis.acceleration_rad_s2 + axis.acceleration_rad_s2 / axis.jerk_rad_s3 for axis in axes
    )


class Interrupter:
    """Runs commands and interrupts them; the drives of one arm are kept, those of two are made again each time.

    Parameters
    ----------
    folder : Path
    period_s : float
        SYNC period.
    seed : int
        Of the instants.
    """

    def __init__(self, folder: Path, period_s: float, seed: int = 1) -> None:
        self._folder, self._pair_period_s = folder, min(period_s, PAIR_PERIOD_S)
        self._rng = random.Random(f"interruptions {seed}")
        self._pair_bus = pair_bus()
        self._pair_proven = False
        self._number = 0
        self.small: Stage | None = None

    def run(self, how: str, command: Command, result: Interruptions) -> None:
        """One command, interrupted; a run that ends by itself before is repeated."""
        for _ in range(TRIES):
            self._number += 1
            with self._stage(command) as stage:
                if self._interrupted(how, command, stage, result):
                    return
        result.complaints.append(f"{command.name}, {how}: ends by itself each time, before what is tried")

    @contextmanager
    def _stage(self, command: Command) -> Iterator[Stage]:
        if not command.pair:
            assert self.small is not None, "the drives of one arm are served by the caller"
            self.small.served.ask("renew")
            yield self.small
            return
        folder = self._folder / "pair"
        if not self._pair_proven:
            with pair_stage(folder, self._pair_period_s, self._pair_bus) as stage:
                prove(stage)
                self._pair_proven = True
        with pair_stage(folder, self._pair_period_s, self._pair_bus) as stage:
            shutil.rmtree(stage.cell.with_suffix(".pair"), ignore_errors=True)
            teach(stage)
            yield stage

    def _interrupted(self, how: str, command: Command, stage: Stage, result: Interruptions) -> bool:
        out = self._folder / f"out-{self._number}"
        out.mkdir()
        program = stage.run(*command.words(stage, out))
        stage.served.ask("logs")
        at_s = self._at(program, stage, command, how)
        if at_s is None:
            program.end(1.0)
            result.early += 1
            if program.code not in (DONE, None) and not disturbed(program.said):
                result.complaints.append(f"{command.name}: ended by itself with {program.code}: {program.said[-300:]}")
            return False
        powered = stage.served.ask("powered")
        ACTIONS[how](program, self._rng)
        code = program.end()
        said = program.said
        tracks: list[Track] = stage.served.ask("logs")
        if code == BUS and disturbed(said):
            result.disturbed += 1
            return False
        if code == DONE and how == "full disk":
            result.early += 1
            return False
        result.runs += 1
        result.powered += powered
        result.commands[command.name] = result.commands.get(command.name, 0) + 1
        what = f"{command.name}, {how} (run {self._number})"
        ending = reduce(Ending.joined, [track.ending(at_s) for track in tracks])
        self._judge(ending, what, result, 0.0 if how == "full disk" else ramp_s(stage.cell) + GRACE_S)
        self._judge_code(code, how, what, said, result)
        if command.records:
            self._judge_file(program, out / "run.h5", what, result)
        shutil.rmtree(out, ignore_errors=True)
        return True

    def _at(self, program: Program, stage: Stage, command: Command, how: str) -> float | None:
        """Time of the random instant; None if the program has ended before."""
        rng = self._rng
        if how != "full disk" and rng.random() < EARLY_SHARE:
            program.wait_for(lambda: False, rng.uniform(0.3, 1.5))
        elif program.wait_for(lambda: stage.served.ask("powered"), POWER_S):
            program.wait_for(lambda: False, rng.uniform(0.0, command.window_s))
        return None if program.code is not None else time.monotonic()

    def _judge(self, ending: Ending, what: str, result: Interruptions, limit_s: float) -> None:
        took_s = max(ending.rest_s, ending.disabled_s, ending.locked_s)
        if limit_s:
            result.longest_s = max(result.longest_s, took_s)
            if took_s > limit_s:
                result.delayed += 1
                result.complaints.append(f"{what}: {ending}, {limit_s:.2f} s are allowed")
        if not ending.over:
            result.unsafe += 1
            result.complaints.append(f"{what}: axes are left under power or without their brakes")
        if ending.dropped_moving:
            result.dropped += 1
            result.complaints.append(f"{what}: {ending.dropped_moving} axes were disabled while they moved")

    def _judge_code(self, code: int | None, how: str, what: str, said: str, result: Interruptions) -> None:
        wanted = INPUT if how == "full disk" else STOPPED
        if code != wanted:
            result.codes += 1
            result.complaints.append(f"{what}: exit code {code}, {wanted} is documented; said: ...{said[-400:]}")

    def _judge_file(self, program: Program, path: Path, what: str, result: Interruptions) -> None:
        announced = program.finished
        result.announced += len(announced)
        try:
            missing = announced - finished_on_disk(path)
        except InputError as error:
            result.lost += 1
            result.complaints.append(f"{what}: {error}")
            return
        if missing:
            result.lost += 1
            result.complaints.append(f"{what}: {sorted(missing)} were announced and are not in the file")


def commands_for(how: str, count: int, seed: int = 1) -> Sequence[Command]:
    """So many commands, each that can be met in this way as often as the others, in random order."""
    able = [command for command in COMMANDS if how != "full disk" or command.writes]
    chosen = [able[number % len(able)] for number in range(count)]
    random.Random(f"{how} {seed}").shuffle(chosen)
    return chosen


def interrupt_commands(
    how: str,
    count: int,
    period_s: float = 0.01,
    seed: int = 1,
    progress: Callable[[], None] = lambda: None,
    only: Sequence[Command] | None = None,
) -> Interruptions:
    """Interrupt commands at random instants and judge what the drives went through.

    Parameters
    ----------
    how : str
        A key of `ACTIONS`.
    count : int
        How many.
    period_s : float
        SYNC period.
    seed : int
        Of the instants.
    progress : callable
        Called after each.
    only : sequence of Command, optional
        Instead of all that can be met in this way.
    """
    result = Interruptions()
    commands = commands_for(how, count, seed) if only is None else only
    with tempfile.TemporaryDirectory(prefix="interruptions-") as name:
        interrupter = Interrupter(Path(name), period_s, seed)
        single = [command for command in commands if not command.pair]
        if single:
            with small_stage(Path(name) / "small", period_s) as stage:
                interrupter.small = stage
                _all(interrupter, how, single, result, progress)
        _all(interrupter, how, [command for command in commands if command.pair], result, progress)
    return result


def _all(
    interrupter: Interrupter,
    how: str,
    commands: Sequence[Command],
    result: Interruptions,
    progress: Callable[[], None],
) -> None:
    for command in commands:
        interrupter.run(how, command, result)
        progress()


__all__ = ["ACTIONS", "Interruptions", "commands_for", "interrupt_commands", "ramp_s"]
