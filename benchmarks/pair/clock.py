"""Two arms in real time: taught, run and kept at a gap, beside the same plant in lockstep.

python -m benchmarks.pair.clock [--seeds 3,4,5,6] [--cycles 25] [--parts run,gap] [--period-ms 4] [--out out/pair-clock]

Twelve drives in a process of their own, over the plant that keeps up with the clock, at a 4 ms SYNC. The period is
longer where this computer is too slow for that. The true force inside the part and the true gaps are recorded.
A cycle that a stall of the machine has stopped is counted and repeated from the start. So is a stop by the force limit
after a delayed SYNC; any other stop fails.
"""

from __future__ import annotations

import math
import re
import threading
import time
import tomllib
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.chaos.processes import PAIR_EXAMPLE, answer, drives, pair_cell
from benchmarks.chaos.programs import pair_bus
from benchmarks.figure import conclude, figure
from benchmarks.pair.bus_rig import Power, bus_spec, patient_cell
from benchmarks.pair.inline import inline
from benchmarks.program import numbers, options
from drives.errors import DriveError, MasterStalled
from gateway.data.visit import ArmSample
from gateway.errors import GatewayError
from gateway.motion.power import powered
from gateway.pair.force import DELAY_TEXT, DELAYED_SHARE
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.pair_motion import PairMotion, PairMotionOptions, PairStopped
from gateway.pair.pair_run import PairRun
from gateway.pair.session import PairLink, cell_gains, embodiment_of, one_relation, open_link
from gateway.pair.teach import TaughtPath, Teacher
from gateway.pair.transform import Floats
from gateway.pair.transform_function import TransformFunction
from sim.pair.gap import GapSensors
from sim.simulation import ServeOptions, Simulation
from tests.support.rigs.pacing import by_the_clock

SPEED, LEARNING, POINTS, GAP_LEARNING, GAP_CYCLES = 1.5, 12, 9, 2, 6
CELL, GAP_CELL = "cell.toml", "distance.toml"
#: SYNC period of both [s], and how many of it a force waits for its answer: two on the bus, 1.5 in the drives' buffers.
PERIOD_S, PERIODS_IN_LOOP = 0.004, 3.5
DAMPING = re.compile(r"(?m)^(impedance_damping|damping_s) = \{ straight = (\S+), turned = (\S+) \}")
#: Largest force in real time over that of the same plant in lockstep; largest gap error [mm].
MOST_OVER_LOCKSTEP, MOST_GAP_MM = 1.1, 0.1
#: Stops of one seed after which it is given up: by stalls of the machine, and by anything else.
STALLS, PATIENCE = 200, 10


class Truth:
    """The largest force inside the part [N], or gap error [m], of every stretch of time, by the monotonic clock."""

    def __init__(self, simulation: Simulation, pair: Mapping[str, Any]) -> None:
        self._world = simulation.servers[0].arms[0].world  # type: ignore[union-attr]
        self._sensors = GapSensors(pair, self._world, 0) if "distance" in pair else None
        if self._sensors is not None:
            self._demanded = np.array([channel["gap_m"] for channel in pair["distance"]["channel"]])
        self._rows = array("d")
        self._world.after.append(self._note)

    def _note(self, _time_s: float) -> None:
        if self._sensors is None:
            value = float(np.linalg.norm(self._world.wrench[:3]))
        else:
            value = float(np.abs(self._sensors.true_m() - self._demanded).max())
        self._rows.extend((time.monotonic(), value))

    def most(self, begin_s: float, end_s: float) -> float:
        """The largest one between two instants; what was before is forgotten."""
        seen, self._rows = self._rows, array("d")  # a copy of what the plant still adds to would end the plant
        rows = np.array(seen).reshape(-1, 2)
        inside = rows[(rows[:, 0] >= begin_s) & (rows[:, 0] <= end_s), 1]
        return float(inside.max())


def _served(folder: Path, edit: Callable[[str], str], bus: str, pipe: Connection, options: Mapping[str, Any]) -> None:
    """Both arms and their drives in this process, until commanded to quit."""
    pair_cell(folder, edit)
    path = folder / CELL
    simulation = Simulation(path, ServeOptions(bus=bus, seed=options["seed"]), plant="light")
    truth = Truth(simulation, tomllib.loads(path.read_text())["pair"])
    thread = threading.Thread(target=simulation.run, name="pair-clock")
    thread.start()
    try:
        answer(pipe, {"hello": lambda: None, "grip": simulation.grip, "most": truth.most})
    finally:
        simulation.stop()
        thread.join()
        simulation.close()


@dataclass(slots=True)
class Bench:
    """A pair and what is truly inside the part: in real time, or in lockstep."""

    cell: PairCell
    link: PairLink
    grip: Callable[[bool], Any]
    most: Callable[[float, float], float]
    power: Power = field(default_factory=Power)
    #: By how much a SYNC of the last cycle was delayed, share of the period.
    delayed: float = 0.0

    def teach(self, path_taught: TaughtPath) -> TransformFunction:
        """First function, by the taught points and those still missing."""
        options = PairMotionOptions()
        stream = self.link.stream(self.cell, options.moves)
        teacher = Teacher(PairMotion(self.cell, stream, options), cell_gains(self.cell))
        with powered(stream):
            teacher.run(path_taught, self.cell.path(1.0).uniform(POINTS), lambda _taught, _point: None)
        return path_taught.function(self.cell.nominal_relation)

    def begin(
        self,
        name: str,
        first: TransformFunction | None,
        back: TransformFunction | None = None,
        laws_s: Floats | None = None,
    ) -> PairRun:
        """An embodiment at rest at the start, moved there with open grippers; a part gripped there free of force."""
        options = PairMotionOptions(speed=SPEED, laws_s=laws_s)
        stream = self.link.stream(self.cell, options.moves)
        row = embodiment_of(self.cell, name)
        run = PairRun(self.cell, stream, row, first or one_relation(self.cell, row, SPEED), options, back)
        holds = self.cell.gap is None
        if holds:
            self.grip(True)
        self.power.on(stream)
        self.power.attempt(run.start)
        if holds:
            self.power.attempt(run.stand)
            self.power.attempt(lambda: run.motion.prepare(lambda: self.grip(False)))
        return run

    def cycle(self, run: PairRun) -> float:
        """One path forward and back; the largest true force [N] or gap error [m] during the path forward."""
        motion, plain, see, at = run.motion, run.motion.run, run.motion.see, list[float]()
        sent = list[tuple[int, float]]()

        def timed(*what: Any, **how: Any) -> Any:
            at.append(time.monotonic())
            streamed = plain(*what, **how)
            at.append(time.monotonic())
            return streamed

        def seen(samples: tuple[ArmSample, ...]) -> None:
            sent.append((samples[0].sync_index, samples[0].time_s))
            see(samples)

        motion.run, motion.see = timed, seen  # type: ignore[method-assign]
        try:
            self.power.attempt(run.cycle)
        finally:
            motion.run, motion.see = plain, see  # type: ignore[method-assign]
        steps = np.diff(np.array(sent), axis=0)
        self.delayed = float(steps[steps[:, 0] == 1.0, 1].max()) / motion.dt_s - 1.0
        most = self.power.attempt(lambda: motion.prepare(lambda: self.most(at[0], at[1])))
        self.power.attempt(run.back)
        return most


def at_period(text: str, period_s: float) -> str:
    """Text of the example's cell at another SYNC period, its hands damped as far above oscillation as before."""
    loop_s = tomllib.loads(text)["pair"]["loop_delay_s"]
    later_s = loop_s + PERIODS_IN_LOOP * (period_s - PERIOD_S)
    text = text.replace(f"sync_period_s = {PERIOD_S}", f"sync_period_s = {period_s}")
    text = text.replace(f"loop_delay_s = {loop_s}", f"loop_delay_s = {later_s:.4f}")

    def scaled(found: re.Match[str]) -> str:
        straight, turned = (float(value) * later_s / loop_s for value in found.groups()[1:])
        return f"{found[1]} = {{ straight = {straight:.6g}, turned = {turned:.6g} }}"

    return DAMPING.sub(scaled, text)


@contextmanager
def clocked(seed: int, period_s: float, file: str = CELL) -> Iterator[Bench]:
    """In real time, the drives in another process."""
    text, bus = at_period((PAIR_EXAMPLE / file).read_text(), period_s), pair_bus()
    with (
        TemporaryDirectory() as folder,
        drives(Path(folder), lambda _text: by_the_clock(text), bus, serve=_served, seed=seed) as served,
    ):
        cell = load_pair(Path(folder) / CELL, bus)
        with open_link(cell) as link:
            yield Bench(
                cell,
                link,
                lambda opened: served.ask("grip", opened),
                lambda begin_s, end_s: served.ask("most", begin_s, end_s),
            )


@contextmanager
def stepped(seed: int | None, period_s: float) -> Iterator[Bench]:
    """The same plant in lockstep, in this process."""
    with TemporaryDirectory() as folder:
        path, buses = patient_cell(Path(folder)), (f"clock-{seed}-l", f"clock-{seed}-r")
        path.write_text(at_period(path.read_text(), period_s))
        simulation = Simulation(path, ServeOptions(bus=bus_spec(buses), seed=seed), plant="light")
        truth = Truth(simulation, {})
        try:
            with inline(simulation.servers, buses):
                cell = load_pair(path, bus_spec(buses))
                with open_link(cell) as link:
                    yield Bench(cell, link, simulation.grip, truth.most)
        finally:
            simulation.close()


@dataclass(slots=True)
class Cycles:
    """What became of the cycles of one seed.

    Attributes
    ----------
    seed : of the arms
    period_s : of the SYNC
    most : largest true force [N] or gap error [m] of every cycle
    sync_delay : by how much a SYNC of every cycle was delayed, share of the period
    function : what was learned last, None = nothing
    laws_s : time constants of the joints, from teaching; None = not identified
    stalled : why cycles were broken off by the machine, one sentence each
    delayed : by the guard of the force after a delayed SYNC of the machine
    stopped : by anything else
    """

    seed: int
    period_s: float
    most: list[float] = field(default_factory=list)
    sync_delay: list[float] = field(default_factory=list)
    function: TransformFunction | None = None
    laws_s: Floats | None = None
    stalled: list[str] = field(default_factory=list)
    delayed: list[str] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)

    def cycles(self, unit: float, digits: int = 0) -> str:
        """What was measured of every cycle; those with a delayed SYNC have a star."""
        pairs = zip(self.most, self.sync_delay, strict=True)
        return " ".join(f"{unit * most:.{digits}f}{'*' * (delayed > DELAYED_SHARE)}" for most, delayed in pairs)

    @property
    def broken_off(self) -> str:
        """How often by what."""
        return f"{len(self.stalled)} stalls, {len(self.delayed)} delayed, {len(self.stopped)} others"

    def calm(self, first: int) -> list[float]:
        """What was measured of the cycles without a delayed SYNC, from a number on."""
        pairs = zip(self.most[first:], self.sync_delay[first:], strict=True)
        return [most for most, delayed in pairs if delayed <= DELAYED_SHARE]


def attempt(attempts: Cycles, opened: Callable[[], AbstractContextManager[Bench]], do: Callable[[Bench], None]) -> None:
    """Do something on a fresh pair; what stops it is noted.

    Raises
    ------
    RuntimeError
        It has been stopped too often.
    """
    try:
        with opened() as bench:
            do(bench)
    except MasterStalled as error:
        attempts.stalled.append(str(error))
    except (DriveError, GatewayError) as error:
        delayed = isinstance(error, PairStopped) and DELAY_TEXT in str(error)
        (attempts.delayed if delayed else attempts.stopped).append(f"{type(error).__name__}: {error}")
    if len(attempts.stalled) + len(attempts.delayed) > STALLS or len(attempts.stopped) > PATIENCE:
        raise RuntimeError(
            f"seed {attempts.seed} stopped too often: {[*attempts.stalled, *attempts.delayed, *attempts.stopped][-1]}"
        )


def cycles_of(opened: Callable[[], AbstractContextManager[Bench]], attempts: Cycles, name: str, count: int) -> Cycles:
    """So many whole cycles, learning off after the twelfth; what is stopped begins again with what was learned."""
    back: TransformFunction | None = None

    def run(bench: Bench) -> None:
        nonlocal back
        run = bench.begin(name, attempts.function, back, attempts.laws_s)
        while len(attempts.most) < count:
            if len(attempts.most) >= LEARNING:
                run.controller.freeze()
            attempts.most.append(bench.cycle(run))
            attempts.sync_delay.append(bench.delayed)
            attempts.function, back = run.controller.function, run.learned_back
        bench.power.off()

    while len(attempts.most) < count:
        attempt(attempts, opened, run)
    return attempts


def taught(seed: int, period_s: float) -> tuple[Cycles, float]:
    """First function, taught in real time, and the largest force that its points were left with, as estimated [N]."""
    attempts, path_taught = Cycles(seed, period_s), TaughtPath("", "")

    def teach(bench: Bench) -> None:
        attempts.function = bench.teach(path_taught)
        attempts.laws_s = path_taught.laws_s

    while attempts.function is None:
        attempt(attempts, lambda: clocked(seed, period_s), teach)
    left_n = max(point.force_n[-1] for point in path_taught.points)
    print(
        f"seed {seed}: taught in real time, at most {left_n:.1f} N left at {len(path_taught.points)} points",
        flush=True,
    )
    return attempts, left_n


def beside(path_taught: Cycles, count: int) -> tuple[Cycles, Cycles]:
    """Row C8 in real time and in lockstep, both begun with the same function."""
    found, seed, period_s = list[Cycles](), path_taught.seed, path_taught.period_s
    for how, opened in (("in real time", clocked), ("in lockstep", stepped)):
        begun = Cycles(seed, period_s, function=path_taught.function, laws_s=path_taught.laws_s)
        attempts = cycles_of(lambda opened=opened: opened(seed, period_s), begun, "C8", count)
        print(f"seed {seed}: C8 {how}: {attempts.cycles(1.0)} N, {attempts.broken_off}", flush=True)
        found.append(attempts)
    return found[0], found[1]


def gap(seed: int, period_s: float) -> Cycles:
    """E5 in real time."""
    attempts = cycles_of(lambda: clocked(seed, period_s, GAP_CELL), Cycles(seed, period_s), "E5", GAP_CYCLES)
    print(f"seed {seed}: E5 in real time: {attempts.cycles(1e3, 3)} mm, {attempts.broken_off}", flush=True)
    return attempts


def run_figures(runs: list[tuple[Cycles, Cycles]], count: int) -> dict[str, dict]:
    """In real time beside lockstep, once learning was over."""
    both = np.array([[max(attempts.most[LEARNING:], default=math.nan) for attempts in pair] for pair in runs])
    over = both[:, 0] / both[:, 1]
    within = np.concatenate(
        [np.array(one.most[LEARNING:]) <= MOST_OVER_LOCKSTEP * max(other.most[LEARNING:]) for one, other in runs]
    )
    clock = [attempts for attempts, _ in runs]
    calm = [most / max(other.most[LEARNING:]) for one, other in runs for most in one.calm(LEARNING)]
    return {
        "C8 in real time, whole cycles": figure(
            sum(len(attempts.most) for attempts in clock), f">= {count * len(runs)}"
        ),
        **stops("C8", clock),
        "C8 in real time, largest force": plain(both[:, 0], "N"),
        "C8 in lockstep, largest force": plain(both[:, 1], "N"),
        "C8 in real time, cycles within 1.1 times lockstep": plain([1e2 * float(np.mean(within))], "%"),
        "C8 in real time, cycles without a SYNC delayed by 0.4 of its period": plain([len(calm)], ""),
        "C8 in real time over lockstep, in these cycles": plain(calm or [math.nan], ""),
        "C8 in real time over lockstep": figure(max(over), f"<= {MOST_OVER_LOCKSTEP}", "", (min(over), max(over))),
    }


def gap_figures(gaps: list[Cycles]) -> dict[str, dict]:
    """Largest gap error of the last cycle of each seed."""
    last = 1e3 * np.array([attempts.most[-1] if attempts.most else math.nan for attempts in gaps])
    calm = [1e3 * most for attempts in gaps for most in attempts.calm(GAP_LEARNING)]
    return {
        **stops("E5", gaps),
        "E5 in real time, cycles from the third on without a delayed SYNC": plain([len(calm)], ""),
        "E5 in real time, gap error in these": plain(calm or [math.nan], "mm"),
        "E5 in real time, gap error": figure(max(last), f"<= {MOST_GAP_MM}", "mm", (min(last), max(last))),
    }


def stops(what: str, clock: list[Cycles]) -> dict[str, dict]:
    """How many cycles were broken off, and by what."""
    stalled, delayed, others = (
        sum(len(getattr(attempts, name)) for attempts in clock) for name in ("stalled", "delayed", "stopped")
    )
    return {
        f"{what} in real time, stopped by a stall of the machine": plain([stalled], ""),
        f"{what} in real time, stopped by the force after a delayed SYNC": plain([delayed], ""),
        f"{what} in real time, stopped by anything else": figure(others, "== 0"),
    }


def plain(values: Sequence[float] | Floats, unit: str) -> dict[str, Any]:
    """The largest of some figures without a goal."""
    return figure(float(max(values)), unit=unit, interval=(float(min(values)), float(max(values))))


def main() -> int:
    """Run, print, write; exit 1 when a goal is missed."""
    parser = options(__doc__, "out/pair-clock")
    parser.add_argument("--seeds", type=numbers, default="3,4,5,6")
    parser.add_argument("--cycles", type=int, default=25)
    parser.add_argument("--parts", default="run,gap")
    parser.add_argument("--period-ms", type=float, default=1e3 * PERIOD_S)
    arguments = parser.parse_args()
    if arguments.cycles <= LEARNING:
        parser.error(f"--cycles: more than {LEARNING}, what comes after learning is judged")
    seeds, parts = arguments.seeds, arguments.parts.split(",")
    period_s = 1e-3 * arguments.period_ms
    out: dict[str, dict] = {"SYNC period": plain([arguments.period_ms], "ms")}
    attempts: list[Cycles] = []
    if "run" in parts:
        first = {seed: taught(seed, period_s) for seed in seeds}
        taught_paths = [path_taught for path_taught, _ in first.values()]
        out |= stops("teaching", taught_paths)
        out["taught in real time, force left at a point"] = plain(
            [left_n for _, left_n in first.values()], "N, estimated"
        )
        runs = [beside(path_taught, arguments.cycles) for path_taught in taught_paths]
        out |= run_figures(runs, arguments.cycles)
        attempts += [*taught_paths, *(clock for clock, _ in runs)]
    if "gap" in parts:
        gaps = [gap(seed, period_s) for seed in seeds]
        out |= gap_figures(gaps)
        attempts += gaps
    for one in attempts:
        for why in (*one.stalled, *one.delayed, *one.stopped):
            print(f"seed {one.seed}, stopped: {why}")
    return conclude(out, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
