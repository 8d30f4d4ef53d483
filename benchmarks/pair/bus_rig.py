"""Two simulated arms and twelve drives in this process, the gateway's side open: what the rows are run on."""

from __future__ import annotations

import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.pair.inline import inline
from gateway.motion.power import powered
from gateway.motion.stream import Stream
from gateway.pair.controller import Embodiment
from gateway.pair.learning_update import led
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.pair_motion import PairMotion, PairMotionOptions
from gateway.pair.pair_run import PairCycle, PairRun
from gateway.pair.pair_store import line_of_grippers
from gateway.pair.session import PairLink, cell_gains, open_link
from gateway.pair.teach import TaughtPath, Teacher
from gateway.pair.transform_function import TransformFunction
from gateway.result.numerals import TWO_SIDED_95
from sim.pair.world import PairWorld
from sim.simulation import ServeOptions, Simulation
from tests.support.rigs.pacing import in_lockstep

Array = NDArray[np.float64]
Done = TypeVar("Done")
OSCILLATION_HZ = 5.0

CELL = Path(__file__).resolve().parents[2] / "examples" / "pair" / "cell.toml"
BACK_SPEED = 1.5
PER_SYNC = 4
#: Above any force of the comparison: rows that exceed the limit are run to their end.
NO_LIMIT_N = 1e6


class Power:
    """Both arms under power from one step of a test to a later one, as `powered` keeps them in one block."""

    def __init__(self) -> None:
        self._stack = ExitStack()

    def on(self, stream: Stream) -> None:
        """Power the arms."""
        self._stack.enter_context(powered(stream))

    def off(self) -> None:
        """Leave the block: the arms are in their brakes."""
        self._stack.close()

    def attempt(self, action: Callable[[], Done]) -> Done:
        """Do something; an error leaves the block as it would have there."""
        try:
            return action()
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise


@dataclass(slots=True)
class PairRig:
    """The simulation and the gateway's side of it."""

    simulation: Simulation
    world: PairWorld
    cell: PairCell
    link: PairLink
    seed: int | None
    power: Power = field(default_factory=Power)

    def teach(self, count: int) -> tuple[TransformFunction, TaughtPath]:
        """First function through `count` points."""
        taught = TaughtPath("", "")
        options = PairMotionOptions(force_limit_n=NO_LIMIT_N)
        stream = self.link.stream(self.cell, options.moves)
        teacher = Teacher(PairMotion(self.cell, stream, options), cell_gains(self.cell))
        with powered(stream):
            teacher.run(taught, self.cell.path(1.0).uniform(count), lambda _taught, _point: None)
        return taught.function(self.cell.nominal_relation), taught

    def run(
        self,
        row: Embodiment,
        first: TransformFunction,
        options: PairMotionOptions,
        back: TransformFunction | None = None,
    ) -> PairRun:
        """A row at rest at the start, powered, the part gripped there free of force."""
        stream = self.link.stream(self.cell, options.moves)
        run = PairRun(self.cell, stream, row, first, options, back)
        self.power.on(stream)
        run.start()
        run.stand()
        self.grip()
        return run

    def grip(self) -> None:
        """Open both grippers and close them again."""
        self.world.catch_up(0)
        self.world.part.grip(self.world.q)

    def cycle(self, run: PairRun) -> tuple[PairCycle, Array]:
        """One way forward; its true record (4 M, 13): time, force, moment, part's centre, fingertip 1."""
        self.world.record.clear()
        self.world.recording = True
        done = self.power.attempt(run.cycle)
        self.world.catch_up(0)
        self.world.recording = False
        return done, np.array(self.world.record[-PER_SYNC * len(run.path) :])


@contextmanager
def pair_rig(seed: int | None, settings: Mapping[str, Any] | None = None) -> Iterator[PairRig]:
    """Both buses on `virtual`; the simulated drives in threads of this process."""
    with simulated(seed, settings=settings) as (simulation, path, buses):
        thread = threading.Thread(target=simulation.run, name="pair-sim")
        thread.start()
        try:
            cell = load_pair(path, bus_spec(buses))
            with open_link(cell) as link:
                yield PairRig(simulation, _world(simulation), cell, link, seed)
        finally:
            simulation.stop()
            thread.join()


@contextmanager
def inline_rig(
    seed: int | None, settings: Mapping[str, Any] | None = None, cell_file: Path = CELL
) -> Iterator[PairRig]:
    """The same rig, of any cell file, the simulated drives in the thread that waits for them."""
    with (
        simulated(seed, cell_file, settings) as (simulation, path, buses),
        inline(simulation.servers, buses),
    ):
        cell = load_pair(path, bus_spec(buses))
        with open_link(cell) as link:
            yield PairRig(simulation, _world(simulation), cell, link, seed)


@contextmanager
def simulated(
    seed: int | None, cell_file: Path = CELL, settings: Mapping[str, Any] | None = None
) -> Iterator[tuple[Simulation, Path, tuple[str, str]]]:
    """Both arms of a cell file, a copy of that file, and the channels of the buses."""
    name = uuid.uuid4().hex
    buses = (f"{name}-l", f"{name}-r")
    with tempfile.TemporaryDirectory() as folder:
        path = patient_cell(Path(folder), cell_file)
        simulation = Simulation(path, ServeOptions(bus=bus_spec(buses), seed=seed), settings=settings)
        try:
            yield simulation, path, buses
        finally:
            simulation.close()


def _world(simulation: Simulation) -> PairWorld:
    return simulation.servers[0].arms[0].world  # type: ignore[return-value]


def bus_spec(buses: tuple[str, str]) -> str:
    """Both buses as on the command line."""
    return f"left=virtual:{buses[0]};right=virtual:{buses[1]}"


def patient_cell(folder: Path, cell_file: Path = CELL) -> Path:
    """A copy of a cell with a master's heartbeat that a busy machine keeps: lockstep has no rhythm to lose."""
    for source in cell_file.parent.iterdir():
        text = source.read_text(encoding="utf-8").replace("consumer_ms = 500", "consumer_ms = 10000")
        (folder / source.name).write_text(in_lockstep(text), encoding="utf-8")
    return folder / cell_file.name


def figures_of(run: PairRun, done: PairCycle, record: Array, limit_n: float) -> dict[str, Any]:
    """Figures of one cycle from the true force inside the part."""
    size = np.linalg.norm(record[:, 1:4], axis=1)
    worst = int(np.argmax(size))
    command = min(worst // PER_SYNC, len(run.path) - 1)
    return {
        "tier": "bus",
        "row": run.config.name,
        "speed": run.path.speed,
        "cycle": done.summary.cycle,
        "force_n": float(size[worst]),
        "moment_nm": float(np.linalg.norm(record[:, 4:7], axis=1).max()),
        "rms_n": float(np.sqrt(np.mean(size**2))),
        "p99_n": float(np.percentile(size, 99.0)),
        "share_above": float(np.mean(size > limit_n)),
        "worst_at_m": float(run.path.s_m[command]),
        "oscillation": oscillation(record[:, 1:7], 1e-3),
        "knots": done.summary.knots,
        "function": done.summary.function,
        "estimated_n": done.summary.force_n,
        **measured_figures(run, done, record),
        "learned": done.summary.learned,
        "complete": done.summary.complete,
        "learning_s": done.learning_s,
        "evaluation_s": done.evaluation_s,
    }


def measured_figures(run: PairRun, done: PairCycle, record: Array) -> dict[str, Any]:
    """Share of the commands at which the 95 % interval of each component holds the truth, and its median half width."""
    if done.internal_force is None:
        return {}
    truth = led(record[PER_SYNC - 1 :: PER_SYNC, 1:7], run.delay)[: len(run.path)]
    half = TWO_SIDED_95 * done.internal_force.std
    return {
        "held": np.mean(np.abs(done.internal_force.wrench - truth) <= half, axis=0).tolist(),
        "half_n": float(np.median(half[:, :3])),
        "half_nm": float(np.median(half[:, 3:])),
    }


def deviation_m(record: Array, alone: Array) -> float:
    """Deviation of the part from the path that the master takes alone, at its fingertip, (n, 3) [m]."""
    return float(cKDTree(alone).query(record[:, 10:13])[0].max())


def along_n(run: PairRun, cell: PairCell, record: Array) -> list[float]:
    """Force along the line between the grippers at every command [N]."""
    force = record[::PER_SYNC, 1:4][: len(run.path)]
    return np.round(np.sum(force * line_of_grippers(cell, run.path)[: len(force)], axis=1), 2).tolist()


def oscillation(internal: Array, dt_s: float) -> float:
    """Return the share of the energy of the internal force (M, 3 or 6) above `OSCILLATION_HZ`."""
    force = internal[:, :3] - internal[:, :3].mean(axis=0)
    power = (np.abs(np.fft.rfft(force, axis=0)) ** 2).sum(axis=1)
    return float(power[np.fft.rfftfreq(len(force), dt_s) > OSCILLATION_HZ].sum() / max(power.sum(), 1e-300))
