"""Requests to stop at random instants of everything that moves, and brakes that fail while they are tried.

Requests: slaves on a wire, in lockstep, so that every instant can be had again from its seed. Falls: the simulator,
whose joints have inertia, friction and a servo of limited torque.
"""

from __future__ import annotations

import random
import time
import uuid
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from unittest import mock

import numpy as np

from drives.bus import BusSpec
from gateway.cell.config import LoadedCell, parse_cell
from gateway.check.brakes import try_brakes
from gateway.check.stop import SPEED_RAD_S, go_slowly, prove_stop
from gateway.motion.opening import OpenArm, open_arm
from gateway.motion.stops import StopDesk, StopKind, StoppedByPerson, StopRequest
from gateway.motion.stream import MoveOptions
from sim.motor import MotorAxis
from sim.serve import running
from tests.drives.conftest import Wire
from tests.support.rigs.pacing import in_lockstep
from tests.support.rigs.wired_arm import FREE_RAD, Joint, last_set_point, ramp_syncs, wired_arm

EXAMPLE: Final = Path(__file__).resolve().parents[2] / "examples" / "small" / "cell.toml"
PERIOD_S: Final = 0.01

#: What is stopped, each with enabling and disabling.
ACTS: Final[dict[str, Callable[[OpenArm, MoveOptions], object]]] = {
    "stop proof": prove_stop,
    "brake test": try_brakes,
    "motion": lambda opened, options: go_slowly(opened, options, np.array(FREE_RAD) + 0.04),
}


def cell_in_lockstep(period_s: float) -> LoadedCell:
    """The small example, in lockstep, with another SYNC period."""
    text = in_lockstep(EXAMPLE.read_text(encoding="utf-8"))
    lines = [f"sync_period_s = {period_s}" if line.startswith("sync_period_s") else line for line in text.splitlines()]
    text = "\n".join(lines) + "\n"
    return LoadedCell(cell=parse_cell(text, str(EXAMPLE)), text=text, folder=EXAMPLE.parent)


@contextmanager
def _rig(loaded: LoadedCell, period_s: float = PERIOD_S) -> Generator[tuple[OpenArm, list[Joint]]]:
    wire = Wire()
    clock = mock.patch.multiple(time, monotonic=wire.monotonic, time=wire.wall, sleep=wire.sleep)
    with clock, wired_arm(wire, loaded, period_s) as opened:
        yield opened


@dataclass(slots=True)
class Answers:
    """How requests to stop were answered.

    Attributes
    ----------
    syncs : SYNCs from each request to the last setpoint, over what the ramp takes
    delayed : what was not answered within one SYNC and the ramp, in words
    """

    syncs: list[int] = field(default_factory=list)
    delayed: list[str] = field(default_factory=list)


def requests(number: int, seed: int, step: Callable[[], None] = lambda: None) -> Answers:
    """Ask for a stop at so many random instants."""
    loaded, answers, rng = cell_in_lockstep(PERIOD_S), Answers(), random.Random(seed)
    lengths = {}
    for name, act in ACTS.items():
        with _rig(loaded) as (opened, slaves):
            act(opened, MoveOptions())
            lengths[name] = len(slaves[0].commands)
    for index in range(number):
        name = list(ACTS)[index % len(ACTS)]
        sync, kind = rng.randrange(1, lengths[name] - 1), rng.choice(list(StopKind))
        _one(loaded, name, sync, kind, answers)
        step()
    return answers


def _one(loaded: LoadedCell, name: str, sync: int, kind: StopKind, answers: Answers) -> None:
    with _rig(loaded) as (opened, slaves):

        def person() -> StopRequest | None:
            return StopRequest(kind, StoppedByPerson("a person")) if slaves[0].sync_seen >= sync else None

        what = f"{name}, SYNC {sync}, {kind.name}"
        try:
            ACTS[name](opened, MoveOptions(StopDesk(person)))
            answers.delayed.append(f"{what}: not stopped")
        except StoppedByPerson:
            ramp = ramp_syncs(opened.workspace, SPEED_RAD_S, PERIOD_S) if kind is StopKind.ALONG_PATH else 0
            over = last_set_point(slaves) - sync - ramp
            answers.syncs.append(over)
            if over > 1:
                answers.delayed.append(f"{what}: setpoints go on for {over + ramp} SYNCs")
            if {slave.state for slave in slaves} != {"switch on disabled"}:
                answers.delayed.append(f"{what}: not all axes are disabled")


def fall(period_s: float, acceleration: float, joint: int, folder: Path) -> tuple[float, str]:
    """Largest angle [rad] of a joint (from 1) whose brake fails as it is tried, at the SYNCs; and the finding."""
    loaded = cell_in_lockstep(period_s)
    path = folder / f"{uuid.uuid4().hex}.toml"
    path.write_text(loaded.text, encoding="utf-8")
    for each in EXAMPLE.parent.iterdir():
        if each.suffix not in (".toml", ".h5") and not (folder / each.name).exists():
            (folder / each.name).symlink_to(each)
    with running(path, bus=f"virtual:{uuid.uuid4()}", pacing="lockstep") as simulation:
        axis: MotorAxis = simulation.simulation.arms[0].world.axes[joint - 1]
        ledger = folder / f"{uuid.uuid4().hex}.json"
        with open_arm(loaded, BusSpec.parse(simulation.bus), ledger=ledger) as opened:
            axis.fall_rad_s2 = acceleration
            at: list[float] = []

            def look() -> StopRequest | None:
                at.append(axis.position_rad)

            def supported(_text: str) -> Callable[[], bool]:
                axis.fall_rad_s2 = 0.0
                return lambda: True

            items = try_brakes(opened, MoveOptions(StopDesk(look)), supported)
            begin = at[len(at) // 2] if items[-1].severity != "fail" else at[0]
            return max(abs(each - begin) for each in at), f"{items[-1].where}: {items[-1].what}"


def fall_without_voltage(period_s: float, acceleration: float) -> float:
    """Largest angle [rad] of a joint of the wire whose brake yields as the voltage is disabled in its test."""
    with _rig(cell_in_lockstep(period_s), period_s) as (opened, slaves):
        slave = slaves[0]
        plain, opened_once = slave.on_frame, [False]

        def on_frame(can_id: int, data: bytes) -> None:
            plain(can_id, data)
            opened_once[0] |= slave.state == "operation enabled"
            if opened_once[0] and slave.state == "switch on disabled":
                slave.falls_rad_s2 = acceleration

        slave.on_frame = on_frame  # type: ignore[method-assign]
        caught: list[float] = []

        def supported(_text: str) -> Callable[[], bool]:
            slave.on_frame, slave.falls_rad_s2 = plain, 0.0  # type: ignore[method-assign]
            caught.append(slave.farthest_rad)
            return lambda: True

        try_brakes(opened, MoveOptions(), supported)
        return max(caught, default=float("inf"))
