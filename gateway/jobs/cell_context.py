"""A cell file with the overrides of the command line (bus, pacing) and the location of the write ledger."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from drives import bringup
from drives.bus import Bus, BusSpec, open_bus
from drives.bus_lock import bus_locked
from drives.group import GroupOptions
from drives.instrument import InstrumentSetup
from drives.nodes import Nodes
from drives.pdo import Offsets
from drives.profile import DriveProfile
from gateway.acquire.blackbox import last_seconds
from gateway.cell.buses import bus_specs
from gateway.cell.config import ArmConfig, LoadedCell, load_cell, with_pacing, with_sync_period
from gateway.errors import WrongPlace
from gateway.model.arm_model import arm_robot
from gateway.motion.opening import OpenArm, axis_setups, open_arm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.pair.gap import instruments_on
from gateway.preflight.drive_check import check_arm, judge_bus_load
from gateway.preflight.machine import judge_surroundings
from gateway.preflight.rules import MOVE_HOME
from gateway.result.result import Finding

#: SYNC period of excitation trajectories, unless that of the cell is shorter [s].
MOVING_SYNC_S: Final = 0.004
#: The write ledger in the state folder.
LEDGER: Final = "ledger.json"
#: Object of the interpolation period.
INTERPOLATION: Final = 0x60C2


@dataclass(frozen=True, slots=True)
class CellContext:
    """A cell file with the overrides of the command line.

    Parameters
    ----------
    loaded : LoadedCell
    path : Path
        The cell file.
    specs : mapping
        Bus of every name in the cell, after the overrides.
    lock : callable
        Locks a bus against other commands on this computer until the running command ends.
    options : tuple of str
        Bus and pacing options as typed, for a proposed command.
    sync_period_s : float or None
        SYNC period, if it differs from that of the file.
    """

    loaded: LoadedCell
    path: Path
    specs: Mapping[str, BusSpec]
    lock: Callable[[BusSpec], None]
    options: tuple[str, ...] = ()
    sync_period_s: float | None = None

    @property
    def arms(self) -> tuple[ArmConfig, ...]:
        """Arms of the cell."""
        return self.loaded.cell.arm

    def bus_spec(self, arm: ArmConfig) -> BusSpec:
        """The bus of an arm."""
        return self.specs[arm.bus]

    def open_bus(self, arm: ArmConfig) -> Bus:
        """Open the bus of an arm; until the command ends no other command may use it."""
        self.reserve(arm)
        return open_bus(self.bus_spec(arm))

    def reserve(self, arm: ArmConfig) -> None:
        """Lock the bus of an arm until the command ends: before the first question about the arm."""
        self.lock(self.bus_spec(arm))

    def profiles(self, arm: ArmConfig) -> tuple[DriveProfile, ...]:
        """Drive profiles of the axes."""
        return tuple(setup.profile for setup in axis_setups(self.loaded, arm))

    def bus_load(self, arm: ArmConfig) -> Finding:
        """Judge the planned load of an arm's bus, all arms on it included."""
        axes = [
            (axis.node_id, profile)
            for other in self.arms
            if other.bus == arm.bus
            for axis, profile in zip(other.axis, self.profiles(other), strict=True)
        ]
        return judge_bus_load(self.loaded.cell.bus[arm.bus], axes, self.instruments(arm))

    def surroundings(self, arm: ArmConfig) -> list[Finding]:
        """Check the connection to the drives of an arm: bus load, other writers, clock of the SYNC."""
        bus = self.loaded.cell.bus[arm.bus]
        return [self.bus_load(arm), *judge_surroundings(bus, self.bus_spec(arm))]

    def instruments(self, arm: ArmConfig) -> tuple[InstrumentSetup, ...]:
        """Return the measuring devices on the bus of an arm."""
        return instruments_on(arm.bus, self.loaded.cell.pair)

    @property
    def ledger(self) -> Path:
        """Return the path of the write ledger, one file for all drives."""
        return _state_folder() / LEDGER

    def check(self, arm: ArmConfig) -> list[Finding]:
        """Run the pre-flight check of an arm: limits of cell and robot, connection and drives. Nothing is written."""
        workspace_of(arm, arm_robot(self.loaded, arm))
        return self.surroundings(arm) + self.check_drives(arm)

    def check_drives(self, arm: ArmConfig) -> list[Finding]:
        """Check the drives of an arm against profile and cell, without the computer. Nothing is written."""
        with self._nodes(arm, ()) as nodes:
            items = check_arm(arm, nodes)
        typed = self.move_command(arm.name, "home")
        return [replace(item, advice=item.advice.replace(MOVE_HOME, typed)) for item in items]

    def stop_proof(self, arm: ArmConfig) -> Path:
        """Return the path of the proof that the drives of an arm stop on loss of the master, at this SYNC period."""
        kind = "-stop" + (f"-{1e6 * self.sync_period_s:.0f}us" if self.sync_period_s else "")
        key = f"{self.path.resolve()}|{arm.name}|{self.bus_spec(arm)}"
        name = f"{self.loaded.cell.name}-{arm.name}-{hashlib.sha256(key.encode()).hexdigest()[:12]}{kind}.json"
        folder = _state_folder()
        folder.mkdir(parents=True, exist_ok=True)
        return folder / "".join(part if part.isalnum() or part in "-_." else "_" for part in name)

    def for_motion(self, arm: ArmConfig) -> CellContext:
        """Return the same cell with the SYNC period of excitation trajectories, if bus load and drives allow it.

        Drives interpolate linearly between setpoints: acceleration is concentrated at each setpoint, where the torque
        is read. A shorter period reduces the error of the torque due to acceleration.
        """
        if self.loaded.cell.bus[arm.bus].sync_period_s <= MOVING_SYNC_S:
            return self
        loaded = with_sync_period(self.loaded, arm.bus, MOVING_SYNC_S)
        faster = replace(self, loaded=loaded, sync_period_s=MOVING_SYNC_S)
        told = all(INTERPOLATION in profile.write.allow for profile in self.profiles(arm))
        return faster if told and faster.bus_load(arm).severity == "ok" else self

    @contextmanager
    def last_seconds(self, options: MoveOptions, *opened: OpenArm) -> Generator[None]:
        """Keep the last seconds of every arm while open; on failure they are stored beside the ledger."""
        with ExitStack() as stack:
            for each in opened:
                stack.enter_context(last_seconds(each, _state_folder(), options.observers))
            yield

    @contextmanager
    def with_move_command(self) -> Generator[None]:
        """Append the command that moves the arm to errors caused by its current position."""
        try:
            yield
        except WrongPlace as error:
            error.add_note(f"To continue, move the arm (asks first): {self.move_command(error.arm, error.to)}")
            raise

    def move_command(self, arm: str, to: str) -> str:
        """Return the command that moves an arm to a posture."""
        named = ["--arm", arm] if len(self.arms) > 1 else []
        return shlex.join(["servo-gateway", "move", str(self.path), *named, *self.options, "--to", to])

    @contextmanager
    def opened(self, arm: ArmConfig, *, trace: Path | None = None, offsets: Offsets = ()) -> Generator[OpenArm]:
        """Open an arm to move it, as `open_arm`; no other command may use its bus until the command ends.

        Parameters
        ----------
        arm : ArmConfig
        trace : Path, optional
            File of the frame log.
        offsets : tuple of str
            Offsets of the drives that the command uses: "velocity", "torque".
        """
        self.reserve(arm)
        spec, ledger = self.bus_spec(arm), self.ledger
        opening = open_arm(self.loaded, spec, arm.name, trace=trace, ledger=ledger, offsets=offsets)
        with self.with_move_command(), opening as opened:
            yield opened

    @contextmanager
    def connected(self, arm: ArmConfig) -> Generator[Nodes]:
        """Connect to the drives of an arm and the measuring device on its bus; identify them, write nothing."""
        with self._nodes(arm, self.instruments(arm)) as nodes:
            bringup.connect(nodes)
            yield nodes

    @contextmanager
    def connected_for_restore(self, arm: ArmConfig) -> Generator[Nodes]:
        """As `connected`, without nodes that do not answer or differ from the expected ones."""
        with self._nodes(arm, self.instruments(arm)) as nodes:
            bringup.connect_for_restore(nodes)
            yield nodes

    @contextmanager
    def _nodes(self, arm: ArmConfig, instruments: tuple[InstrumentSetup, ...]) -> Generator[Nodes]:
        config = self.loaded.cell.bus[arm.bus]
        options = GroupOptions(
            ledger_path=self.ledger,
            instruments=instruments,
            allow_real_drive=config.allow_real_drive,
        )
        setups = axis_setups(self.loaded, arm)
        with (
            self.open_bus(arm) as bus,
            Nodes(bus, setups, config.sync_period_s, config.pacing, options=options) as nodes,
        ):
            yield nodes


def _state_folder() -> Path:
    """Return the folder of the ledgers (XDG base directory specification)."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "servo-gateway"


def open_cell(
    path: Path, bus_spec: str | None, lock: Callable[[BusSpec], None], pacing: str | None = None
) -> CellContext:
    """Read a cell file; `bus_spec` replaces buses as `bus_specs` says, `pacing` that of every bus.

    Raises
    ------
    ConfigError
        The file cannot be used, or the bus is ambiguous.
    BusError
        The SPEC is not understood.
    """
    loaded = with_pacing(load_cell(path), pacing)
    return CellContext(loaded, path, bus_specs(loaded.cell, bus_spec), lock, typed_options(bus_spec, pacing))


@contextmanager
def locked_cell(path: Path, bus: str | None = None, pacing: str | None = None) -> Generator[CellContext]:
    """Read a cell file for a Python program; each bus that it uses is locked until the block ends. As `open_cell`."""
    with ExitStack() as stack:
        locked = set[str]()

        def lock(spec: BusSpec) -> None:
            if spec.wire not in locked:
                stack.enter_context(bus_locked(spec, "a Python program"))
                locked.add(spec.wire)

        yield open_cell(path, bus, lock, pacing)


def typed_options(bus_spec: str | None, pacing: str | None) -> tuple[str, ...]:
    """Return bus and pacing as command line arguments; defaults are omitted."""
    typed = (("--bus", bus_spec), ("--pacing", pacing))
    return tuple(word for name, value in typed if value is not None for word in (name, value))
