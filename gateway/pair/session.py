"""Teaching and running a pair from its files to its files, over both arms connected and configured on two buses."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gateway.data.disk import Disk
from gateway.errors import ConfigError, InputError
from gateway.motion.arms import Arms
from gateway.motion.opening import OpenArm, open_arm
from gateway.motion.power import powered
from gateway.motion.stops import guarded
from gateway.motion.stream import MoveOptions, Stream
from gateway.pair.controller import DISTANCE_GAINS, EMBODIMENTS, Embodiment, with_gains
from gateway.pair.gap import instruments_on
from gateway.pair.impedance import Gains
from gateway.pair.pair_cell import PairCell
from gateway.pair.pair_motion import PairMotion, PairMotionOptions, refuse_elsewhere
from gateway.pair.pair_run import PairCycle, PairRun
from gateway.pair.pair_store import PairStore, run_result
from gateway.pair.teach import AFRESH, TaughtPath, Teacher, TeachRule, read_taught_path
from gateway.pair.transform import Floats
from gateway.pair.transform_function import (
    SpeedTable,
    TransformFunction,
    constant_function,
    read_stored,
    refuse_foreign,
    sampled,
    transform_of,
)
from gateway.result.pair import LinkStatistics, PairRunResult, Skew, TaughtPoint

#: What can be run without the simulator's truth.
RUNNABLE = tuple(name for name, row in EMBODIMENTS.items() if row.first != "exact")


def cell_gains(cell: PairCell) -> Gains:
    """Return the impedance of the cell file."""
    distance = cell.config.distance
    if distance is not None:
        damping = distance.damping_s
        return DISTANCE_GAINS if damping is None else Gains((damping.straight, damping.turned))
    force = cell.config.force
    spring = (0.0, 0.0) if force.spring is None else (force.spring.straight, force.spring.turned)
    return Gains((force.damping.straight, force.damping.turned), spring)


def embodiment_of(cell: PairCell, name: str) -> Embodiment:
    """Return an embodiment by name, with the cell's impedance.

    Raises
    ------
    ConfigError
        No such row, or it needs what no cell has.
    """
    if name not in RUNNABLE:
        raise ConfigError(f"embodiment '{name}' cannot be run in a cell; choose one of {', '.join(RUNNABLE)}")
    row = EMBODIMENTS[name]
    if cell.gap is not None and row.first == "fixed" and row.corrects == "none":
        return replace(row, sensing="distance")
    if row.sensing == "distance" and cell.gap is None:
        raise ConfigError(
            f"embodiment '{name}' keeps a gap by distance sensors, and cell '{cell.loaded.cell.name}' has none; declare"
            " them in [pair.distance]"
        )
    if row.sensing == "force" and cell.gap is not None:
        raise ConfigError(
            f"embodiment '{name}' needs a common part, and the arms of cell '{cell.loaded.cell.name}' keep a gap"
            " ([pair.distance]); choose E5, or A to compare with"
        )
    return with_gains(row, cell_gains(cell))


def open_taught_path(cell: PairCell, store: PairStore, resume: bool) -> TaughtPath:
    """Return the taught points to resume, or an empty taught path.

    Raises
    ------
    InputError
        There are points and `--resume` was not given, or they are for another path or cell.
    ConfigError
        The arms of this cell keep a gap: teaching needs a force.
    """
    if cell.gap is not None:
        raise ConfigError(
            f"cell '{cell.loaded.cell.name}' keeps a gap by distance sensors ([pair.distance]): there is no common part"
            " to be taught by force; use pair run --variant E5"
        )
    if not store.points.exists():
        return TaughtPath(store.path_hash, store.cell_hash)
    if not resume:
        raise InputError(
            f"{store.points}: holds taught points; go on with --resume, or delete the file to teach afresh"
        )
    return read_taught_path(store.points, store.path_hash, store.cell_hash)


def teach_pair(
    link: PairLink,
    cell: PairCell,
    store: PairStore,
    taught_path: TaughtPath,
    report: Callable[[TaughtPoint, int, int], None],
    options: PairMotionOptions | None = None,
) -> TransformFunction:
    """Teach the missing points and store the first function.

    Parameters
    ----------
    report : callable
        Called with each new point, its number and how many there will be.
    """
    options = options or PairMotionOptions()
    refuse_elsewhere(cell, link.together.where())
    # slower trajectories and sweeps are planned, so that forces are measured at their speed
    stream = link.stream(cell, replace(options.moves, override=1.0))
    motion = PairMotion(cell, stream, options)
    plain, share = TeachRule(), options.moves.override
    rule = replace(plain, path_speed_m_s=share * plain.path_speed_m_s, sweep_s=plain.sweep_s / share)
    teacher = Teacher(motion, cell_gains(cell), rule)
    indices = cell.path(1.0).uniform(cell.config.knots)

    def save(present: TaughtPath, point: TaughtPoint) -> None:
        motion.prepare(lambda: store.write("points.json", present.to_json()))
        guarded(report, options.moves.desk)(point, len(present.points), len(indices))

    with powered(stream):
        teacher.run(taught_path, indices, save)
    function = taught_path.function(cell.nominal_relation)
    store.save("first", function, learn_source="taught", speed=0.0, embodiment="C1")
    return function


def first_function(cell: PairCell, store: PairStore, row: Embodiment, speed: float) -> tuple[TransformFunction, str]:
    """Return the function that a run begins with, and its origin.

    Raises
    ------
    InputError
        Nothing was taught, or the stored function is for another path or cell.
    """
    if row.first == "fixed":
        second = None if row.learning is None else store.load("second")
        if second is not None and second.embodiment == row.name:
            return transform_of(second), f"learned by {second.embodiment} {second.date}"
        return one_relation(cell, row, speed), "one relation, from the start"
    first = store.load("first")
    if first is None:
        raise InputError(f"{store.folder}: holds no first function; run teach before this embodiment")
    if row.first == "speed_table":
        return speed_table(store, transform_of(first)).at(speed), "interpolated between stored speeds"
    if row.learning is None:
        return transform_of(first), f"taught {first.date}"
    second = store.load("second")
    if second is None or second.embodiment != row.name:
        return transform_of(first), f"taught {first.date}"
    return transform_of(second), f"learned by {second.embodiment} {second.date}"


def servo_laws(cell: PairCell, store: PairStore, row: Embodiment) -> Floats | None:
    """Return how each joint (J, 2) follows, estimated during teaching [s]; None for a run without taught points.

    Raises
    ------
    InputError
        The taught points are damaged, or for another path or cell.
    """
    if row.first == "fixed" or not store.points.exists():
        return None
    laws_s = read_taught_path(store.points, store.path_hash, store.cell_hash).laws_s
    joints = sum(arm.axes for arm in cell.arms)
    if laws_s is not None and len(laws_s) != joints:
        raise InputError(f"{store.points}: servo_law_s has {len(laws_s)} entries for {joints} joints; {AFRESH}")
    return laws_s


def function_back(store: PairStore, row: Embodiment) -> TransformFunction | None:
    """Return the learned function of the return of this embodiment, None = nothing.

    Raises
    ------
    InputError
        It is for another path or cell.
    """
    back = None if row.learning is None else store.load("back")
    return transform_of(back) if back is not None and back.embodiment == row.name else None


def one_relation(cell: PairCell, row: Embodiment, speed: float) -> TransformFunction:
    """Return the constant relation of the grasps, with knots at the learning points if the embodiment learns."""
    function = constant_function(cell.nominal_relation)
    if row.learning is None:
        return function
    path = cell.path(speed)
    return sampled(function, np.unique(path.s_m[path.in_time(row.points)]))


def speed_table(store: PairStore, first: TransformFunction) -> SpeedTable:
    """Return the learned functions of all speeds; speed 0 is the taught function."""
    functions = {0.0: first}
    for path in sorted(store.folder.glob("speed-*.json")):
        stored = read_stored(path)
        refuse_foreign(stored, store.path_hash, store.cell_hash, str(path))
        functions[stored.speed] = transform_of(stored)
    return SpeedTable(functions)


def run_pair(
    link: PairLink,
    cell: PairCell,
    store: PairStore,
    row: Embodiment,
    count: int,
    report: Callable[[PairCycle], None],
    options: PairMotionOptions | None = None,
) -> PairRunResult:
    """Run so many cycles of an embodiment; store the learned function and the data of the report."""
    options = options or PairMotionOptions()
    moves = options.moves
    speed = options.speed or cell.config.speed
    first, _ = first_function(cell, store, row, speed)
    if row.first == "speed_table":
        row = replace(row, learning=None)
    refuse_elsewhere(cell, link.together.where())
    # a path that is planned slower is learned from as it is driven
    stream = link.stream(cell, replace(moves, override=1.0))
    options = replace(options, speed=speed * moves.override, laws_s=servo_laws(cell, store, row))
    run = PairRun(cell, stream, row, first, options, function_back(store, row))
    if store.frozen or moves.first_done is not None:  # a first motion is slower than what is learned
        run.controller.freeze()
    cycles: list[PairCycle] = []

    def kept() -> PairRunResult:
        result = run_result(cell, run, cycles, link.statistics())
        store.keep(result)
        return result

    try:
        with powered(stream):
            run.start()
            for _ in range(count):
                cycles.append(run.cycle())
                run.motion.prepare(lambda: _keep(store, run, cycles))
                guarded(report, moves.desk)(cycles[-1])
                if run.back():
                    run.motion.prepare(lambda: _keep_back(store, run, cycles))
    except BaseException:
        if cycles:
            kept()
        raise
    return kept()


def _keep(store: PairStore, run: PairRun, cycles: list[PairCycle]) -> None:
    """Store the function at once after a cycle that changed it."""
    second = run.controller.state().second
    if cycles[-1].summary.learned and second is not None:
        path = store.save("second", second, **_origin(run, cycles))
        store.write(f"speed-{run.path.speed:g}.json", path.read_text(encoding="utf-8"))


def _keep_back(store: PairStore, run: PairRun, cycles: list[PairCycle]) -> None:
    """Store the function of the return."""
    learned = run.learned_back
    if learned is not None:
        store.save("back", learned, **_origin(run, cycles))


def _origin(run: PairRun, cycles: list[PairCycle]) -> dict[str, Any]:
    rule = run.config.learning
    return {
        "learn_source": "command" if rule is None else rule.source,
        "speed": run.path.speed,
        "embodiment": run.config.name,
        "cycles": len(cycles),
    }


class PairLink:
    """Both arms of a pair, connected to their buses.

    Parameters
    ----------
    opened : master and slave
    together : the same under one clock
    """

    def __init__(self, opened: tuple[OpenArm, OpenArm], together: Arms) -> None:
        self.opened, self.together = opened, together

    def stream(self, cell: PairCell, options: MoveOptions) -> Stream:
        """Return the stream of both arms."""
        return Stream(self.together, tuple(each.workspace for each in self.opened), cell.sync_period_s, options)

    def statistics(self) -> LinkStatistics:
        """Return the counters of both buses so far."""
        first, second = (each.group.statistics for each in self.opened)
        return LinkStatistics(
            pacing="real" if self.together.real else "lockstep",
            cycles=(first.cycles, second.cycles),
            incomplete=(first.incomplete, second.incomplete),
            late=(first.late, second.late),
            skew_s=_skew(self.together.skew_s) if self.together.real else None,
        )


def _skew(skew_s: Sequence[float]) -> Skew:
    skew = np.array(skew_s) if skew_s else np.zeros(1)
    size = np.abs(skew)
    return Skew(float(np.median(skew)), float(np.percentile(size, 99)), float(size.max()))


@contextmanager
def open_link(cell: PairCell, ledger: Path | None = None) -> Generator[PairLink]:
    """Connect and configure both arms; on leaving all drives are disabled and both buses closed.

    Raises
    ------
    ConfigError, DriveError
        As `open_arm`.
    """
    with ExitStack() as opened:
        arms, disk = [], opened.enter_context(Disk())
        for arm, spec in zip(cell.arms, cell.specs, strict=True):
            on_bus, name = instruments_on(arm.config.bus, cell.config), arm.config.name
            opening = open_arm(
                cell.loaded, spec, name, ledger=ledger, offsets=("torque",), instruments=on_bus, disk=disk
            )
            arms.append(opened.enter_context(opening))
        together = Arms([each.arm for each in arms], cell.pacing)
        opened.callback(together.close)
        yield PairLink((arms[0], arms[1]), together)
