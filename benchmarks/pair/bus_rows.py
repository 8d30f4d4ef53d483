"""The rows of the comparison over PyBullet and twelve CAN drives, for one seed."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pair.bus_gap import gaps_in_the_cell
from benchmarks.pair.bus_hostile import hostile
from benchmarks.pair.bus_paths import drawn_cell
from benchmarks.pair.bus_rig import BACK_SPEED, NO_LIMIT_N, PairRig, along_n, deviation_m, figures_of, inline_rig
from drives.errors import DriveError
from gateway.errors import LimitExceeded, PlanRefused
from gateway.pair.controller import EMBODIMENTS, Embodiment, with_gains
from gateway.pair.pair_motion import PairMotionOptions, PairStopped
from gateway.pair.pair_run import PairRun
from gateway.pair.session import cell_gains
from gateway.pair.transform_function import ExtrapolationWarning, SpeedTable, TransformFunction, constant_function
from gateway.result.values import plain_values
from sim.states import PdsState

Row = dict[str, Any]

STATIC, SLOW, BETWEEN, USUAL, BEYOND, FAST = 0.05, 0.75, 1.1, 1.5, 1.8, 3.0
LEARNING = 13
E2_CYCLES = 6
SNAG_N = 20.0
#: Cycles at each speed along a path that the seed has drawn: learning has settled by then.
ELSEWHERE = 5
#: Paths that a seed may draw until one is not refused.
DRAWS = 10
#: What later stages begin with.
LEARNED_BY = (f"C8@{USUAL:g}", f"C8@{USUAL:g} back")


@dataclass(frozen=True, slots=True)
class Taught:
    """First function, and how each joint (J, 2) was seen to follow meanwhile [s]."""

    nine: TransformFunction
    laws_s: NDArray[np.float64] | None


@dataclass(slots=True)
class Bench:
    """One seed: its rig, what was taught, and what was gathered."""

    rig: PairRig
    taught: Taught
    frozen_cycles: int
    rows: list[Row] = field(default_factory=list)
    curves: list[Row] = field(default_factory=list)
    functions: dict[str, TransformFunction] = field(default_factory=dict)
    #: Path of the master alone, by `_path_name`.
    alone: dict[str, Any] = field(default_factory=dict)

    @property
    def limit_n(self) -> float:
        """Largest force that the part may feel."""
        return self.rig.cell.config.force_limit_n

    def row_of(self, name: str) -> Embodiment:
        """A row with the gains of the cell file."""
        return with_gains(EMBODIMENTS[name], cell_gains(self.rig.cell))

    def first(self, row: Embodiment) -> TransformFunction:
        """First function of a row."""
        return constant_function(self.rig.cell.nominal_relation) if row.first == "fixed" else self.taught.nine

    def laws_s(self, row: Embodiment) -> NDArray[np.float64] | None:
        """How each joint follows, for rows that begin with what was taught."""
        return None if row.first == "fixed" else self.taught.laws_s

    def run(
        self,
        label: str,
        row: Embodiment,
        speed: float,
        cycles: int = 1,
        first: TransformFunction | None = None,
        back: TransformFunction | None = None,
        freeze_after: int = 10**6,
        snag_cycle: int = 0,
    ) -> TransformFunction:
        """Cycles of one row; returns the function it ends with."""
        rig = self.rig
        options = PairMotionOptions(
            speed=speed, back_speed=BACK_SPEED, force_limit_n=NO_LIMIT_N, laws_s=self.laws_s(row)
        )
        run = rig.run(row, first or self.first(row), options, back)
        curve: Row = {"cycles": []}
        for number in range(1, cycles + 1):
            if number > freeze_after:
                run.controller.freeze()
            if number == snag_cycle:
                rig.world.push = _snag(rig)
            done, record = rig.cycle(run)
            rig.world.push = None
            figures = figures_of(run, done, record, self.limit_n)
            if (path_name := _path_name(row, speed)) in self.alone:
                figures["part_off_m"] = deviation_m(record, self.alone[path_name])
            self.rows.append({**figures, "row": label, "seed": rig.seed, "frozen": number > freeze_after})
            curve["cycles"].append(figures)
            curve["last_n"] = along_n(run, rig.cell, record)
            curve.setdefault("first_n", curve["last_n"])
            if number < cycles:
                run.back()
        path = run.path
        curve |= {"name": label, "text": row.text, "speed": speed, "s_m": path.s_m.tolist()}
        curve["x_m"] = (rig.cell.arms[0].world_from_base @ path.commands)[:, 0, 3].tolist()
        curve["knots_s_m"] = run.controller.function.s_m.tolist()
        self.curves.append(curve)
        run.back()
        rig.power.off()
        self.functions[f"{label}@{speed:g}"] = run.controller.function
        if run.learned_back is not None:
            self.functions[f"{label}@{speed:g} back"] = run.learned_back
        return run.controller.function


def _path_name(row: Embodiment, speed: float) -> str:
    """Name of the path that the master takes alone: joints that are sent ahead as they follow take another one."""
    return f"{speed:g}" if row.first == "fixed" else f"{speed:g} fed"


def _snag(rig: PairRig) -> Any:
    """Joint torques of 20 N on the fingertip of arm 2, across the line between the grippers."""
    torque = np.zeros(12)
    torque[6:] = rig.world.part.at(rig.world.q).jacobian[1, 6:] * SNAG_N
    return torque


def plain(bench: Bench) -> None:
    """Rows without learning at the usual speed."""
    without_learning(bench, USUAL)


def without_learning(bench: Bench, speed: float) -> None:
    """Rows C1i, B and A, the gentlest first: the watch for contact may stop the others, and what comes after them."""
    for name in ("C1i", "B", "A"):
        try:
            bench.run(name, bench.row_of(name), speed)
        except LimitExceeded as error:
            stopped = {"row": f"{name} stopped", "seed": bench.rig.seed, "speed": speed, "why": str(error)}
            bench.rows.append({"tier": "bus", **stopped})
            return


def each(bench: Bench) -> None:
    """Learning in every cycle."""
    bench.run("C2c", bench.row_of("C2c"), USUAL, E2_CYCLES)


def mean(bench: Bench) -> None:
    """Learning from three cycles at a time, fixed points."""
    bench.run("C7", bench.row_of("C7"), USUAL, LEARNING)


def points(bench: Bench) -> None:
    """Learning points where force acts, then frozen."""
    bench.run("C8", bench.row_of("C8"), USUAL, LEARNING - 1 + bench.frozen_cycles, freeze_after=LEARNING - 1)


def others(bench: Bench) -> None:
    """What else there is at the usual speed."""
    bench.run("C1", bench.row_of("C1"), USUAL)
    bench.run("C2m", bench.row_of("C2m"), USUAL, E2_CYCLES)
    bench.run("C8r", bench.row_of("C8r"), USUAL, LEARNING)


def even(bench: Bench) -> None:
    """C8u: as many learning points as C8 ended with, evenly spread over what was taught."""
    path = bench.rig.cell.path(USUAL)
    points = path.uniform(len(bench.functions[LEARNED_BY[0]]))
    lengths = np.unique(path.s_m[points])
    spread = TransformFunction(lengths, *_split(bench.taught.nine.many(lengths)))
    bench.run("C8u", bench.row_of("C8u"), USUAL, LEARNING, first=spread)


def _split(poses: Any) -> tuple[Any, Any]:
    return poses[:, :3, 3], poses[:, :3, :3]


def speeds(bench: Bench) -> None:
    """E3: learned at .75 and 1.5, used at 1.1 and 1.8 without any learning there; and what learning at 1.1 reaches.

    The first cycle of a run does not know the arms' constants, the second does.
    """
    slow = bench.run("C2c", bench.row_of("C2c"), SLOW, E2_CYCLES)
    known = {0.0: bench.taught.nine, SLOW: slow, USUAL: bench.functions[f"C2c@{USUAL:g}"]}
    for speed in (BETWEEN, BEYOND):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExtrapolationWarning)
            table = SpeedTable(known).at(speed)
        bench.run("C1i", bench.row_of("C1i"), speed, 2)
        bench.run("C3", bench.row_of("C3"), speed, 2, first=table)
    bench.run("C2c", bench.row_of("C2c"), BETWEEN, E2_CYCLES)


def fast(bench: Bench) -> None:
    """Rows without learning at twice the usual speed."""
    without_learning(bench, FAST)


def fast_points(bench: Bench) -> None:
    """Learning points at twice the usual speed, begun with what the usual speed has taught, then frozen."""
    first, back = (bench.functions[name] for name in LEARNED_BY)
    cycles = LEARNING - 1 + bench.frozen_cycles
    bench.run("C8", bench.row_of("C8"), FAST, cycles, first=first, back=back, freeze_after=LEARNING - 1)


def static(bench: Bench) -> None:
    """Geometry alone: nearly standing still, taught at 9, at 17 and at 33 points."""
    bench.run("A", bench.row_of("A"), STATIC)
    bench.run("C1", bench.row_of("C1"), STATIC)
    for count in (17, 33):
        finer, _ = bench.rig.teach(count)
        bench.run(f"C1 N={count}", bench.row_of("C1"), STATIC, first=finer)


def snag(bench: Bench) -> None:
    """A cable pulls arm 2 for one cycle: with learning off, and with the mean and the median of five cycles.

    How far two functions are apart that were learned without any cable is what no representative value can undercut.
    A cycle that is not learned from leaves its block to the one after the fifth.
    """
    off = bench.run("C7 off", bench.row_of("C7"), USUAL, 3, freeze_after=0, snag_cycle=2)
    moved: dict[str, float] = {}

    def apart_m(one: TransformFunction, other: TransformFunction) -> float:
        return float(np.linalg.norm(one.position_m - other.position_m, axis=1).max())

    for kind in ("mean", "median"):
        row = bench.row_of("C7")
        if row.learning is None:
            continue
        row = replace(row, learning=replace(row.learning, cycles=5, kind=kind))
        plain = bench.run(f"C7 {kind}", row, USUAL, 5)
        caught = bench.run(f"C7 {kind} snag", row, USUAL, 6, snag_cycle=3)
        moved[kind] = apart_m(plain, caught)
        if kind == "median":
            moved["repeat"] = apart_m(plain, bench.run("C7 median again", row, USUAL, 5))
    same = bool(np.array_equal(off.knots, bench.taught.nine.knots))
    summary = {f"{name}_m": value for name, value in moved.items()} | {"frozen_identical": same}
    bench.rows.append({"tier": "bus", "row": "snag", "seed": bench.rig.seed, "speed": USUAL, **summary})


def first_slower(run: PairRun, decided: list[float], now_s: Callable[[], float]) -> list[float]:
    """Time at which the first setpoints slower than planned are sent once a stop is decided, as the only entry."""
    begun: list[float] = []
    stream = run.motion.stream
    plain = stream.drive

    def drive(source: Any, what: str) -> None:
        planned = source.targets
        source.targets = lambda *at: (decided and not begun and at[1] < 1.0 and begun.append(now_s()), planned(*at))[1]
        plain(source, what)

    stream.drive = drive  # type: ignore[method-assign]
    return begun


def stop(bench: Bench) -> None:
    """The comparison example with its limit in force: both arms have to stop, and the force stays bounded."""
    rig, states = bench.rig, []
    drives = [drive for unit in rig.simulation.arms for drive in unit.drives]

    def note(time_s: float) -> None:
        moving = sum(drive.automaton.state is PdsState.OPERATION_ENABLED for drive in drives)
        states.append((time_s, moving, float(np.linalg.norm(rig.world.wrench[:3]))))

    run = rig.run(bench.row_of("A"), bench.first(bench.row_of("A")), PairMotionOptions(speed=USUAL))
    decided: list[float] = []
    desk = run.motion.stream.options.desk
    plain = desk.ask
    desk.ask = lambda *wish: (decided.append(rig.world.time_s), plain(*wish))[1]  # type: ignore[method-assign]
    begun = first_slower(run, decided, lambda: rig.world.time_s)
    rig.world.after.append(note)
    why = ""
    try:
        rig.power.attempt(run.cycle)
    except (PairStopped, DriveError) as error:
        why = str(error)
    rig.world.after.remove(note)
    rig.power.off()
    period = rig.cell.sync_period_s
    left = next((time_s for time_s, moving, _ in states if moving == 0), float("nan"))
    first = next((time_s for time_s, moving, _ in states if moving < len(drives)), float("nan"))
    after = [force for time_s, _, force in states if decided and time_s >= decided[0]]
    bench.rows.append(
        {
            "tier": "bus",
            "row": "stop",
            "seed": rig.seed,
            "speed": USUAL,
            "stopped": bool(decided) and "above" in why,
            "begun_syncs": (begun[0] - decided[0]) / period + 1.0 if begun else float("nan"),
            "syncs": (left - decided[0]) / period if decided else float("nan"),
            "apart_syncs": (left - first) / period,
            "force_at_stop_n": after[0] if after else float("nan"),
            "force_after_n": max(after, default=float("nan")),
        }
    )


#: Stages that run in the rig of the seed.
STAGES: dict[str, Callable[[Bench], None]] = {
    "plain": plain,
    "each": each,
    "mean": mean,
    "points": points,
    "others": others,
    "even": even,
    "speeds": speeds,
    "fast": fast,
    "fast_points": fast_points,
    "static": static,
    "snag": snag,
    "stop": stop,
}


def skewed(seed: int, taught: Taught) -> list[Row]:
    """C8 with the slave's SYNC delayed by a constant 0.5 ms, and by another 0 to 1 ms each time."""
    rows: list[Row] = []
    for label, skew_s, jitter_s in (("C8 skew .5 ms", 0.5e-3, 0.0), ("C8 jitter 1 ms", 0.0, 1.0e-3)):
        with inline_rig(seed, {"skew_s": skew_s, "skew_jitter_s": jitter_s}) as rig:
            bench = Bench(rig, taught, 0)
            bench.run(label, bench.row_of("C8"), USUAL, LEARNING)
            rows += bench.rows
    return rows


def halved(seed: int, taught: Taught) -> list[Row]:
    """Row C1i with the physics step halved."""
    with inline_rig(seed, {"step_s": 0.125e-3}) as rig:
        bench = Bench(rig, taught, 0)
        bench.run("C1i, half the step", bench.row_of("C1i"), USUAL)
        return bench.rows


def elsewhere(seed: int) -> list[Row]:
    """C8 at both speeds along the first path that the seed has drawn and the planner does not refuse, taught there."""
    for refused in range(DRAWS):
        try:
            return along_drawn(seed, refused)
        except PairStopped:  # was not refused beforehand
            raise
        except PlanRefused:
            continue
    raise RuntimeError(f"seed {seed} has drawn {DRAWS} paths, all are refused")


def along_drawn(seed: int, refused: int) -> list[Row]:
    """The same along the path that comes after so many of the seed."""
    with TemporaryDirectory() as folder, inline_rig(seed, cell_file=drawn_cell(Path(folder), seed, refused)) as rig:
        nine, taught_path = rig.teach(9)
        bench = Bench(rig, Taught(nine, taught_path.laws_s), 0)
        row, usual = bench.row_of("C8"), f"C8 elsewhere@{USUAL:g}"
        bench.run("C8 elsewhere", row, USUAL, ELSEWHERE)
        first, back = bench.functions[usual], bench.functions[f"{usual} back"]
        bench.run("C8 elsewhere", row, FAST, ELSEWHERE, first=first, back=back)
        return bench.rows


#: Stages that need another cell, and nothing taught.
ALONE: dict[str, Callable[[int], list[Row]]] = {"distance": gaps_in_the_cell, "elsewhere": elsewhere}

#: Stages that need rigs of their own.
APART: dict[str, Callable[[int, Taught], list[Row]]] = {"skew": skewed, "step": halved}

#: Stages that need rigs of their own and what the usual speed has taught.
AFTERWARDS: dict[str, Callable[[int, NDArray[np.float64] | None, TransformFunction, TransformFunction], list[Row]]] = {
    "hostile": hostile
}


def run_stage(seed: int, stage: str, frozen_cycles: int, stored: dict[str, Any] | None) -> dict[str, Any]:
    """One stage of one seed, added to what earlier stages of this seed have given; teaches first if none has.

    Returns
    -------
    dict
        Rows, curves, functions, taught points, statistics of the buses.
    """
    began = time.monotonic()
    seen = stored or _untouched(seed)
    if stage not in ALONE and "nine" not in seen:
        seen |= _taught(seed)
    if stage in ALONE:
        seen["rows"] += ALONE[stage](seed)
    elif stage in APART:
        seen["rows"] += APART[stage](seed, _taught_relation(seen))
    elif stage in AFTERWARDS:
        learned = (_function(seen["functions"][name]) for name in LEARNED_BY)
        seen["rows"] += AFTERWARDS[stage](seed, _taught_relation(seen).laws_s, *learned)
    else:
        with inline_rig(seed) as rig:
            bench = Bench(rig, _taught_relation(seen), frozen_cycles)
            bench.functions = {name: _function(knots) for name, knots in seen["functions"].items()}
            bench.alone = {name: np.array(path_name) for name, path_name in seen["alone"].items()}
            STAGES[stage](bench)
            _count(seen, rig)
        seen["rows"] += bench.rows
        seen["curves"] += bench.curves
        seen["functions"] = {name: _knots(function) for name, function in bench.functions.items()}
    seen["stages"].append(stage)
    seen["minutes"] += (time.monotonic() - began) / 60.0
    return seen


def _untouched(seed: int) -> dict[str, Any]:
    """A seed of which nothing is known."""
    statistics = {"cycles": 0, "incomplete": 0}
    return {"seed": seed, "stages": [], "minutes": 0.0, "statistics": statistics, "rows": [], "curves": []}


def _taught(seed: int) -> dict[str, Any]:
    """What is known of a seed once it is taught: its function, and the paths of the master alone."""
    seen: dict[str, Any] = {"statistics": {"cycles": 0, "incomplete": 0}}
    with inline_rig(seed) as rig:
        nine, taught_path = rig.teach(9)
        _count(seen, rig)
    points = plain_values(taught_path.points)
    laws = None if taught_path.laws_s is None else taught_path.laws_s.tolist()
    seen |= {"functions": {}, "points": points, "nine": _knots(nine), "laws_s": laws}
    taught = _taught_relation(seen)
    alone = {
        _path_name(EMBODIMENTS[name], speed): np.round(_alone(seed, taught, name, speed), 7).tolist()
        for name in ("A", "C1")
        for speed in (USUAL, FAST)
    }
    return seen | {"alone": alone}


def _alone(seed: int, taught: Taught, name: str, speed: float) -> Any:
    """Path (n, 3) of the master's fingertip under a row when nothing is held between the arms [m]."""
    with inline_rig(seed) as rig:
        rig.world.part.let_go()
        bench = Bench(rig, taught, 0)
        row = bench.row_of(name)
        options = PairMotionOptions(speed=speed, force_limit_n=NO_LIMIT_N, laws_s=bench.laws_s(row))
        _, record = rig.cycle(rig.run(row, bench.first(row), options))
        rig.power.off()
        return record[:, 10:13]


def _count(seen: dict[str, Any], rig: PairRig) -> None:
    statistics = rig.link.statistics()
    for name in seen["statistics"]:
        seen["statistics"][name] += sum(getattr(statistics, name))


def _taught_relation(seen: dict[str, Any]) -> Taught:
    """What was taught, from what is kept of a seed."""
    laws = seen.get("laws_s")
    return Taught(_function(seen["nine"]), None if laws is None else np.array(laws, dtype=float))


def _knots(function: TransformFunction) -> list[Any]:
    return [function.s_m.tolist(), function.position_m.tolist(), function.rotation.tolist()]


def _function(knots: list[Any]) -> TransformFunction:
    return TransformFunction(*knots)
