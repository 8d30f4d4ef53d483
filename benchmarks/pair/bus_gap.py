"""The gap kept by distance sensors over PyBullet and CAN: twelve drives and a measuring device, for one seed."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pair.bus_rig import BACK_SPEED, CELL, Power, bus_spec, simulated
from benchmarks.pair.inline import inline
from gateway.pair.pair_cell import PairCell, load_pair
from gateway.pair.pair_motion import PairMotionOptions
from gateway.pair.pair_run import PairRun
from gateway.pair.session import PairLink, embodiment_of, one_relation, open_link
from sim.measuring import FakeMeasuringDevice
from sim.pair.gap import GapSensors
from sim.pair.world import PairWorld

Array = NDArray[np.float64]
Row = dict[str, Any]

SPEED = 1.5
CYCLES = 6


@dataclass(slots=True)
class GapRig:
    """The simulation, its measuring device, true distances, and the gateway's side."""

    world: PairWorld
    device: FakeMeasuringDevice
    sensors: GapSensors
    demanded_m: Array
    cell: PairCell
    link: PairLink
    arms: list[Any]
    power: Power = field(default_factory=Power)

    def run(self, name: str, speed: float) -> PairRun:
        """An embodiment at rest at the start, powered."""
        row = embodiment_of(self.cell, name)
        options = PairMotionOptions(speed=speed, back_speed=BACK_SPEED)
        stream = self.link.stream(self.cell, options.moves)
        run = PairRun(self.cell, stream, row, one_relation(self.cell, row, speed), options)
        self.power.on(stream)
        run.start()
        return run

    def cycle(self, run: PairRun) -> tuple[Any, Array]:
        """One way forward; its true deviations (M, n) from the demanded distances [m], one per SYNC."""
        true: list[Array] = []

        def note(_time_s: float) -> None:
            true.append(self.sensors.true_m() - self.demanded_m)

        self.world.after.append(note)
        done = self.power.attempt(run.cycle)
        self.world.catch_up(0)
        self.world.after.remove(note)
        # what a SYNC shows is what the stretch before it has ended with
        return done, np.array(true[-len(run.path) - 1 : -1])


@contextmanager
def gap_rig(seed: int | None) -> Iterator[GapRig]:
    """Both buses of the example cell with distance sensors, the simulated devices in the thread that waits for them."""
    with (
        simulated(seed, CELL.with_name("distance.toml")) as (simulation, path, buses),
        inline(simulation.servers, buses),
    ):
        table = tomllib.loads(path.read_text(encoding="utf-8"))["pair"]
        world: PairWorld = simulation.servers[0].arms[0].world  # type: ignore[assignment]
        demanded = np.array([channel["gap_m"] for channel in table["distance"]["channel"]])
        cell = load_pair(path, bus_spec(buses))
        with open_link(cell) as link:
            device = simulation.servers[1].instruments[0]
            yield GapRig(world, device, GapSensors(table, world, 0), demanded, cell, link, simulation.arms)


def gaps_in_the_cell(seed: int) -> list[Row]:
    """Largest true deviation of any gap: by one relation without correction, then per cycle with learning."""
    rows: list[Row] = []
    with gap_rig(seed) as rig:
        for name, cycles in (("A", 1), ("E5", CYCLES)):
            run = rig.run(name, SPEED)
            for cycle in range(1, cycles + 1):
                done, true = rig.cycle(run)
                rows.append(
                    {
                        "tier": "bus",
                        "row": "gap" if name == "A" else name,
                        "seed": seed,
                        "speed": SPEED,
                        "cycle": cycle,
                        "gap_m": float(np.abs(true).max()),
                        "sensed_gap_m": done.summary.gap_m,
                        "learned": done.summary.learned,
                        "learning_s": done.learning_s,
                    }
                )
                run.back()
            rig.power.off()
    return rows
