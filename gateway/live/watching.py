"""Observe arms that another program moves: convert frames of their buses for the page. Nothing is sent."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drives.bus import BusSpec, open_bus
from drives.cia402 import State, decode_state
from drives.epoch import Epoch
from drives.listen_only import ListenOnlyBus
from drives.scaling import Constants
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.data.recording.reader import read
from gateway.data.visit import ArmSample
from gateway.errors import ConfigError, InputError
from gateway.live.drawing import shown_arm
from gateway.live.feed import Feed
from gateway.live.wire import Heard, ShownCell
from gateway.model.arm_model import arm_robot
from gateway.model.regressor import gravity_regressor
from gateway.motion.arm import JointSide
from gateway.motion.observer import Observed
from gateway.motion.opening import axis_setups
from gateway.motion.state import Phase, StateTracker
from gateway.motion.workspace import Workspace, workspace_of

Floats = NDArray[np.float64]

#: Reading time per bus [s], at most the least time between two samples of the page.
TURN_S: Final = 0.005
#: Time without SYNC after which no master is assumed [s].
SILENT_S: Final = 2.0
#: Setpoint change per SYNC below which the arm is at rest [rad].
STILL_RAD: Final = 1e-7
UNKNOWN: Final = (
    "are unknown: positions and torques cannot be read; start this page before the command that moves, or "
    "give a recording of them with --constants"
)


class WatchedArm:
    """One arm on its bus.

    Parameters
    ----------
    config : ArmConfig
    workspace : Workspace
    overheard : ListenOnlyBus

    Attributes
    ----------
    sample : ArmSample or None
        Sample of the last received SYNC.
    target_rad : array of shape (N,)
        Last joint setpoints; NaN if none was received.
    phase : Phase
        Phase of the arm, derived from drive states and commands.
    """

    def __init__(self, config: ArmConfig, workspace: Workspace, overheard: ListenOnlyBus) -> None:
        self.name, self.workspace, self.overheard = config.name, workspace, overheard
        self._axes = AxisConversion.from_arm(config)
        self._side = JointSide(self._axes)
        self.sample: ArmSample | None = None
        self.target_rad: Floats = np.full(workspace.robot.axes, np.nan)
        self.phase = Phase.UNKNOWN

    def listen(self) -> bool:
        """Process received frames; return whether a SYNC is complete."""
        self.overheard.bus.listen(TURN_S)
        epochs = self.overheard.epochs()
        if not epochs:
            return False
        motor = [np.nan if each is None else each for each in self.overheard.targets_rad()]
        before, self.target_rad = self.target_rad, self._axes.joint_position(np.array(motor))
        self.sample = self._side.sample(epochs[-1])
        moves = bool((np.abs(self.target_rad - before) > STILL_RAD).any())
        self.phase = _phase(epochs[-1], moves)
        return True

    def modelled_nm(self) -> Floats:
        """Return the modelled torque (N,) of the unloaded arm at the current posture; NaN if unknown."""
        links = self.workspace.links
        if links is None or self.sample is None or np.isnan(self.sample.q_rad).any():
            return np.full(self.workspace.robot.axes, np.nan)
        gravity = gravity_regressor(self.workspace.robot, self.sample.q_rad[None], self.workspace.gravity_m_s2)
        return gravity[0] @ links


def _phase(epoch: Epoch, moves: bool) -> Phase:
    states = [decode_state(reading.statusword) for reading in epoch.readings if reading is not None]
    if State.QUICK_STOP_ACTIVE in states or State.FAULT_REACTION_ACTIVE in states:
        return Phase.STOPPING
    if State.OPERATION_ENABLED not in states:
        return Phase.IN_BRAKES if len(states) == len(epoch.readings) else Phase.UNKNOWN
    return Phase.MOVING if moves else Phase.HOLDING


class Watching:
    """Feed of the page from received frames.

    Parameters
    ----------
    arms : sequence of WatchedArm
    feed : Feed
    period_s : float
        SYNC period, as the cell has it.
    clock : callable
        Monotonic time [s].
    """

    def __init__(
        self, arms: Sequence[WatchedArm], feed: Feed, period_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._arms, self._feed, self._clock = arms, feed, clock
        self._state = StateTracker(arms[0].name, lambda _state: None)
        self._heard_s = clock()
        self._silent = False
        self._untold = {arm.name for arm in arms}
        feed.show(ShownCell(tuple(shown_arm(arm.name, arm.workspace) for arm in arms), period_s), self._state)

    def turn(self) -> None:
        """Read every bus briefly and forward the received frames."""
        received = [arm.listen() for arm in self._arms]
        for arm in self._arms:
            while arm.overheard.emergencies:
                emergency = arm.overheard.emergencies.popleft()
                self._feed.reported(Heard("plain" if emergency.is_harmless else "fail", str(emergency)))
        if any(received):
            self._heard_s, self._silent = self._clock(), False
            self._hand_on()
        elif not self._silent and self._clock() - self._heard_s > SILENT_S:
            self._silent = True
            self._feed.reported(Heard("warn", "no SYNC received: no master is controlling these drives"))
            self._state.enter(Phase.UNKNOWN)
            self._feed.ended(None)

    def _hand_on(self) -> None:
        for arm in self._arms:
            if arm.overheard.unknown and arm.name in self._untold:
                self._untold.discard(arm.name)
                nodes = ", ".join(map(str, arm.overheard.unknown))
                self._feed.reported(Heard("warn", f"arm '{arm.name}': the constants of nodes {nodes} {UNKNOWN}"))
        samples = tuple(arm.sample for arm in self._arms if arm.sample is not None)
        if len(samples) < len(self._arms):
            return
        phases = [arm.phase for arm in self._arms]
        for phase in (Phase.STOPPING, Phase.MOVING, Phase.HOLDING, Phase.UNKNOWN, Phase.IN_BRAKES):
            if phase in phases:
                self._state.enter(phase, samples[0].sync_index)
                break
        targets = tuple(arm.target_rad for arm in self._arms)
        self._feed.sampled(Observed(samples, targets, tuple(arm.modelled_nm() for arm in self._arms)))


def stored_constants(path: Path, arm: ArmConfig) -> tuple[Constants, ...]:
    """Return the drive constants of an arm from a recording.

    Raises
    ------
    InputError
        It cannot be read, or holds none of this arm.
    """
    stored = read(path).arm(arm.name)
    if stored is None or len(stored.constants) != len(arm.axis):
        raise InputError(
            f"{path}: contains no constants of the drives of arm '{arm.name}'; give a recording of this cell"
        )
    return stored.constants


def watch(loaded: LoadedCell, specs: Mapping[str, BusSpec], feed: Feed, recording: Path | None = None) -> None:
    """Read the buses of a cell and update the page, until the page or the command is ended.

    Parameters
    ----------
    loaded : LoadedCell
    specs : mapping
        Bus of every name in the cell.
    feed : Feed
    recording : Path, optional
        Of this cell: constants of its drives.

    Raises
    ------
    ConfigError
        The robot cannot be used, or the bus lives in one program alone.
    InputError
        The recording cannot be used.
    BusError
        A bus cannot be opened, or fails.
    """
    with ExitStack() as stack:
        arms = []
        for config in loaded.cell.arm:
            spec = specs[config.bus]
            if spec.interface == "virtual":
                raise ConfigError(
                    f"bus '{config.bus}' is {spec}, which lives in one program alone: there is nothing to watch from "
                    "another one; give the command that moves --live"
                )
            workspace = workspace_of(config, arm_robot(loaded, config))
            constants = None if recording is None else stored_constants(recording, config)
            bus = stack.enter_context(open_bus(spec))
            arms.append(WatchedArm(config, workspace, ListenOnlyBus(bus, axis_setups(loaded, config), constants)))
        watching = Watching(arms, feed, loaded.cell.bus[loaded.cell.arm[0].bus].sync_period_s)
        while not feed.gone:
            watching.turn()
            feed.pressed()
