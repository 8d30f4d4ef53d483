"""Teach and run two arms that carry one workpiece, and show, switch off or delete what their runs have learned."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import Operator, begin_motion
from gateway.motion.stream import MoveOptions
from gateway.pair.pair_cell import PairCell, pair_of
from gateway.pair.pair_motion import PairMotionOptions, refuse_elsewhere
from gateway.pair.pair_store import PairStore
from gateway.pair.session import PairLink, embodiment_of, first_function, open_link, open_taught_path, teach_pair
from gateway.pair.session import run_pair as run_cycles
from gateway.result.pair import STAGES, CycleSummary, LearnStatus, PairRunResult, TaughtPoint


def pair_files(context: CellContext, store: Path | None = None) -> tuple[PairCell, PairStore]:
    """Return the pair of a cell and the store of its files, which by default is beside the cell file.

    Raises
    ------
    ConfigError, InputError
        As `gateway.pair.pair_cell.load_pair`.
    """
    pair = pair_of(context.path, context.loaded, context.specs)
    return pair, PairStore(pair, store or context.path.with_suffix(".pair"))


@contextmanager
def _in_motion(
    context: CellContext, pair: PairCell, what: str, operator: Operator, options: MoveOptions
) -> Generator[tuple[PairLink, MoveOptions]]:
    """Open both arms and ask; the stop of their drives was proven before, in slow motion with open grippers."""
    for arm in pair.arms:
        context.reserve(arm.config)
    for arm in pair.arms:
        for line in arm.said:
            operator.say(f"arm '{arm.config.name}', {line}")
    held = "with the part gripped" if pair.gap is None else f"with '{pair.arms[1].config.name}' clear of the part"
    what = f"are at the start {held} and will {what}"
    with context.with_move_command(), open_link(pair, context.ledger) as link:
        refuse_elsewhere(pair, link.together.where())
        options = begin_motion(context, link.opened, options, operator, what=what, proof="stored")
        with context.last_seconds(options, *link.opened):
            yield link, options


def teach(
    context: CellContext,
    operator: Operator,
    options: MoveOptions,
    *,
    resume: bool = False,
    store: Path | None = None,
    report: Callable[[TaughtPoint, int, int], None] = lambda _point, _done, _count: None,
) -> tuple[Path, tuple[TaughtPoint, ...]]:
    """Teach the first function of a pair, after confirmation: the force is reduced to zero at points of the path.

    Each point is stored at once.

    Parameters
    ----------
    context : CellContext
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    resume : bool
        Continue with the missing points.
    store : Path, optional
        Folder of functions and runs; default: beside the cell file.
    report : callable
        Called with each new point, its number and the number of all points.

    Returns
    -------
    Path, tuple of TaughtPoint
        File of the function, and all its points, those of earlier calls included.

    Raises
    ------
    ConfigError, InputError
        As `pair_files` and `gateway.pair.session.open_taught_path`; nothing moved.
    WrongPlace
        An arm is not at the start of the path; nothing moved.
    FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `begin_motion` and `gateway.pair.session.teach_pair`.
    """
    pair, files = pair_files(context, store)
    taught_path = open_taught_path(pair, files, resume)
    what = f"move slowly along the path, to {pair.config.knots - len(taught_path.points)} points"
    with _in_motion(context, pair, what, operator, options) as (link, move_options):
        teach_pair(link, pair, files, taught_path, report, PairMotionOptions(moves=move_options))
    return files.folder / "first.json", tuple(taught_path.points)


def run_pair(
    context: CellContext,
    embodiment: str,
    operator: Operator,
    options: MoveOptions,
    *,
    cycles: int = 1,
    speed: float | None = None,
    store: Path | None = None,
    announce: Callable[[str], None] = lambda _text: None,
    report: Callable[[CycleSummary], None] = lambda _summary: None,
) -> PairRunResult:
    """Carry the part along the path of a pair and back, after confirmation. What is learned is stored at once.

    Parameters
    ----------
    context : CellContext
    embodiment : str
        Name of a row of `gateway.pair.controller.EMBODIMENTS`.
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    cycles : int
        Number of cycles, each to the end of the path and back.
    speed : float, optional
        Speed setting; default: that of the cell.
    store : Path, optional
        Folder of functions and runs; default: beside the cell file.
    announce : callable
        Called with the embodiment, the function it begins with and whether it learns, before the drives are opened.
    report : callable
        Called with each finished cycle.

    Returns
    -------
    PairRunResult
        Also stored for the report; of a run that is stopped, the finished cycles are stored.

    Raises
    ------
    ConfigError, InputError
        As `pair_files`, `embodiment_of` and `first_function` of `gateway.pair.session`; nothing moved.
    WrongPlace
        An arm is not at the start of the path; nothing moved.
    FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `begin_motion` and `gateway.pair.session.run_pair`.
    """
    pair, files = pair_files(context, store)
    row, speed = embodiment_of(pair, embodiment), speed or pair.config.speed
    _, origin = first_function(pair, files, row, speed)
    announce(f"{row.name}, {row.text}; function: {origin}; learning {'off' if files.frozen else 'on'}")
    what = f"run {cycles} cycles at speed {speed:g}"
    with _in_motion(context, pair, what, operator, options) as (link, move_options):
        motion = PairMotionOptions(speed=speed, moves=move_options)
        return run_cycles(link, pair, files, row, cycles, lambda cycle: report(cycle.summary), motion)


def learn(
    context: CellContext,
    action: Literal["status", "freeze", "resume", "reset"] = "status",
    *,
    store: Path | None = None,
    say: Callable[[str], None] = lambda _text: None,
) -> LearnStatus:
    """Return what the runs of a pair have learned, after learning was frozen, resumed or reset. Needs no bus.

    Parameters
    ----------
    context : CellContext
    action : str
        `reset` deletes what runs have learned, and learning is on again.
    store : Path, optional
        Folder of functions and runs; default: beside the cell file.
    say : callable
        Shows whether `reset` has deleted something.

    Raises
    ------
    ConfigError, InputError
        As `pair_files`, or a stored function is damaged or of another path or cell.
    """
    _, files = pair_files(context, store)
    if action == "reset":
        say("the learned function is deleted" if files.forget() else "there was nothing to delete")
    elif action != "status":
        files.freeze(action == "freeze")
    return LearnStatus(
        learning="off" if files.frozen else "on",
        functions={stage: None if (stored := files.load(stage)) is None else stored.origin for stage in STAGES},
    )
