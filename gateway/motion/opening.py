"""Connect and configure the drives of an arm from a cell file; the brakes stay on."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from uuid import uuid4

import numpy as np

from drives.bus import Bus, BusSpec, open_bus
from drives.drive import AxisSetup, Identity
from drives.errors import ProfileError
from drives.group import DriveGroup, GroupOptions
from drives.instrument import InstrumentSetup
from drives.pdo import Offsets
from drives.profile import DriveProfile
from drives.scaling import Constants
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.cell.conversion import AxisConversion
from gateway.data.disk import Disk
from gateway.data.recording.bus_log import FrameLog
from gateway.errors import ConfigError
from gateway.feedforward.identified import axis_constants, read_identified
from gateway.model.arm_model import arm_named, robot_from_text, robot_place, robot_text
from gateway.motion import drive_limits
from gateway.motion.arm import Arm
from gateway.motion.stops import StopKind, StopRequest, StopSource
from gateway.motion.workspace import Workspace, workspace_of
from gateway.preflight.drive_check import look_over, require_passed
from gateway.preflight.rules import CONFIRM_TORQUE, Readings


@dataclass(frozen=True, slots=True, eq=False)
class OpenArm:
    """Arm with connected and configured drives, brakes on.

    Attributes
    ----------
    loaded : LoadedCell
    config : ArmConfig
    robot_text : str
    workspace : Workspace
    profiles : tuple of DriveProfile, one per axis
    group : DriveGroup
    arm : Arm
    identities : tuple of Identity, one per axis
    constants : tuple of Constants, one per axis
        Read from the drives.
    readings : tuple of Readings, one per axis
        Objects of each drive before configuration, (index, subindex) -> value.
    disk : Disk
        The process that writes what a motion leaves.
    log : FrameLog or None
        Frame log of the bus.
    session : str
        Unique for each connection to the drives.
    """

    loaded: LoadedCell
    config: ArmConfig
    robot_text: str
    workspace: Workspace
    profiles: tuple[DriveProfile, ...]
    group: DriveGroup
    arm: Arm
    identities: tuple[Identity, ...]
    constants: tuple[Constants, ...]
    readings: tuple[Readings, ...]
    disk: Disk
    log: FrameLog | None = None
    session: str = field(default_factory=lambda: uuid4().hex)


def frame_log_watched(opened: OpenArm) -> StopSource:
    """Return a source that requests a stop along the path once the frame log of an arm's bus cannot be written."""

    def failed() -> StopRequest | None:
        failure = None if opened.log is None else opened.log.failure
        return None if failure is None else StopRequest(StopKind.ALONG_PATH, failure)

    return failed


@contextmanager
def logged(bus: Bus, path: Path | None, disk: Disk) -> Generator[FrameLog | None]:
    """Log the frames of a bus to a file; None: no log.

    Raises
    ------
    BusError
        The file cannot be written, or its suffix is unknown.
    OSError
        The log is incomplete; this is a note instead where another error passes.
    """
    if path is None:
        yield None
        return
    log = FrameLog(disk, path)
    bus.add_tap(log.take)
    error: BaseException | None = None
    try:
        yield log
    except BaseException as passing:
        error = passing
        raise
    finally:
        bus.remove_tap(log.take)
        log.close()
        if log.failure is not None and error is None:
            raise log.failure
        if error is not None and log.failure not in (None, error):
            error.add_note(f"{log.failure.filename}: {log.failure.strerror}")


def axis_setups(loaded: LoadedCell, config: ArmConfig) -> tuple[AxisSetup, ...]:
    """Return the settings of the drives from the cell file.

    Raises
    ------
    ProfileError
        A profile cannot be read, or a constant is missing.
    """
    axes = AxisConversion.from_arm(config)
    speeds = np.array([axis.speed_limit_rad_s for axis in config.axis])
    motor_rad_s = np.abs(axes.ratio) * (np.abs(axes.coupling) @ speeds)
    return tuple(
        AxisSetup(
            axis.node_id,
            loaded.profile(axis.profile),
            axis.torque_constant_nm_per_a.value,
            float(speed),
            position_limit_rad=limit,
        )
        for axis, speed, limit in zip(config.axis, motor_rad_s, drive_limits.motor_ranges_rad(config), strict=True)
    )


def _refuse_unprepared(setups: Sequence[AxisSetup], config: ArmConfig) -> None:
    """Refuse an arm that may not move by its profiles or its cell file, before anything is sent.

    Raises
    ------
    ProfileError
        The profile of a drive does not allow motion.
    ConfigError
        A torque limit, on which contact detection depends, is a placeholder.
    """
    joints: dict[DriveProfile, list[str]] = {}
    for joint, setup in enumerate(setups, start=1):
        if setup.profile.obstacles:
            joints.setdefault(setup.profile, []).append(f"J{joint}")
    if joints:
        what = "; ".join(
            f"{', '.join(axes)}: profile {profile.name} refuses motion: {'; '.join(profile.obstacles)}"
            for profile, axes in joints.items()
        )
        raise ProfileError(what, advice="`scan` and `check` read such drives; nothing was sent to them")
    found = [(joint, axis) for joint, axis in enumerate(config.axis, start=1) if axis.torque_limit_is_assumed]
    if found:
        axes = ", ".join(f"J{joint} {axis.torque_limit_nm:g} Nm" for joint, axis in found)
        what = f"arm {config.name}: torque_limit_nm is not confirmed ({axes}: {found[0][1].torque_limit_source})"
        raise ConfigError(f"{what}; {CONFIRM_TORQUE}; nothing was sent to the drives")


@contextmanager
def open_arm(
    loaded: LoadedCell,
    spec: BusSpec | None = None,
    arm: str | None = None,
    *,
    trace: Path | None = None,
    ledger: Path | None = None,
    offsets: Offsets = (),
    instruments: tuple[InstrumentSetup, ...] = (),
    disk: Disk | None = None,
) -> Generator[OpenArm]:
    """Connect, check and configure the drives of an arm; on exit they are disabled and the bus is closed.

    An error that passes says what was just read of an arm that has been under power.

    The pre-flight check runs here: nothing is written to a drive that fails it.

    Parameters
    ----------
    loaded : LoadedCell
    spec : BusSpec, optional
        Bus instead of that of the cell file; SYNC period and pacing remain those of the cell file.
    arm : str, optional
        Name of the arm, if the cell has several.
    trace : Path, optional
        File of the frame log (`.blf`, `.log`).
    ledger : Path, optional
        Folder of the write ledger.
    offsets : tuple of str
        Offsets of the drives that the command uses: "velocity" (0x60B1), "torque" (0x60B2).
    instruments : tuple of InstrumentSetup
        Measuring devices that are read with the drives.
    disk : Disk, optional
        Process that writes for several arms, closed by the caller; by default one of this arm.

    Raises
    ------
    ConfigError
        Robot or cell file cannot be used.
    InputError
        The identification named by the cell belongs to another arm, or contradicts it.
    ProfileError
        The profile of a drive allows reading only.
    DriveError
        Bus failure, or drives that are missing, duplicate, of another type or in fault; all are named at once.
    FindingFailed
        The settings of a drive do not allow motion.
    """
    config = arm_named(loaded, arm)
    text = robot_text(loaded, config)
    robot = robot_from_text(config, text, robot_place(loaded, config))
    workspace = workspace_of(config, robot)
    known = axis_constants(config, read_identified(loaded, config, robot))
    setups, axes = axis_setups(loaded, config), AxisConversion.from_arm(config)
    _refuse_unprepared(setups, config)
    setups = tuple(replace(setup, offsets=offsets) for setup in setups)
    bus_config = loaded.cell.bus[config.bus]
    options = GroupOptions(ledger_path=ledger, instruments=instruments, allow_real_drive=bus_config.allow_real_drive)
    with (
        Disk() if disk is None else nullcontext(disk) as writing,
        open_bus(spec or bus_config.spec) as bus,
        logged(bus, trace, writing) as log,
        DriveGroup(bus, setups, bus_config.sync_period_s, bus_config.pacing, options=options) as group,
    ):
        identities = group.connect()
        refusing, readings = look_over(config, group)
        require_passed(refusing, "check failed, the arm is not moved")
        ramp = drive_limits.quick_stop_rad_s2(config, [setup.profile for setup in setups], readings)
        if ramp is not None:  # motions may accelerate harder than a quick stop decelerates: the larger counts
            hardest = np.maximum(ramp, workspace.acceleration_rad_s2)
            if (needed_nm := drive_limits.needed_torque_nm(workspace, config, hardest, known)) is not None:
                limits_nm = drive_limits.motor_torques_nm(axes, needed_nm).tolist()
                for drive, limit_nm in zip(group.drives, limits_nm, strict=True):
                    drive.setup = replace(drive.setup, torque_limit_nm=limit_nm)
        group.configure()
        opened = OpenArm(
            loaded=loaded,
            config=config,
            robot_text=text,
            workspace=workspace,
            profiles=tuple(setup.profile for setup in setups),
            group=group,
            arm=Arm(config.name, group, axes, known),
            identities=identities,
            constants=tuple(drive.scale.constants for drive in group.drives),
            readings=readings,
            disk=writing,
            log=log,
        )
        try:
            yield opened
        except BaseException as error:
            if group.sync_index:  # power was on at least once
                kept = "" if hasattr(error, "exit_code") else "; what was measured is kept"
                error.add_note(f"Arm '{config.name}': {group.gate()}{kept}.")
            raise
