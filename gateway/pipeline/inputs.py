"""Collect the inputs of `estimate` and `diagnose`: robot, gravity, gears, known loads, stored unloaded arm, samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from drives.errors import ProfileError
from drives.profile import DriveProfile
from drives.profile_file import find_profile, parse_profile
from gateway.cell.calibration import calibration_path
from gateway.cell.config import REPORTED_STD_PERCENT, ArmConfig, AxisConfig, LoadedCell, load_cell
from gateway.cell.conversion import AxisConversion
from gateway.cell.quantities import parse_inertials
from gateway.data.recording.binding import Correction, bind, refuse_other_drives
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording, arm_config
from gateway.data.table import Table, is_recording, read_data
from gateway.errors import ConfigError, InputError
from gateway.estimate.posture import refuse_other_bare
from gateway.identify.knowledge import Knowledge
from gateway.model.arm_model import arm_named, arm_robot, robot_from_text
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2, kinematic_difference
from gateway.model.load_bounds import LoadBounds, load_bounds
from gateway.model.robot import Robot, or_another_tip, robot_from_urdf
from gateway.model.urdf_text import read_urdf
from gateway.pipeline.calibrated import Calibrated, calibrated, serial_numbers
from gateway.pipeline.known import KnownLoad, in_last_link, unnamed_frame
from gateway.pipeline.torque_size import refuse_small_torques, without_constant_torques
from gateway.result.data_roles import Roles
from gateway.result.result import Finding, Result, read_result

VALIDATION = "x_validation"
#: Ratio of the torque drift of a warm arm to the usual drift: half a kelvin instead of 10 K.
WARM_CHANGE: Final = 0.05


@dataclass(frozen=True, slots=True)
class ModelRequest:
    """Options of the command line that define the model.

    Attributes
    ----------
    robot, cell, bare : Path or None
    inertials : str or None
    known : mapping of label to KnownLoad
    parts : mapping of the label of a part to those of the gripper with the part and of the gripper alone
    arm : str or None
        Name of the arm, if the cell has several.
    gain_std : float or None
        Relative standard deviation of every torque constant, instead of those of the cell file.
    tip : str or None
        Last link of the arm in its URDF, instead of that of the cell file.
    is_warm : bool
        The arm was warm: its torque readings change by less than usual.
    calibrated : bool
        Use the torque constants of the calibration file, where there is one.
    """

    robot: Path | None = None
    cell: Path | None = None
    inertials: str | None = None
    known: Mapping[str, KnownLoad] = field(default_factory=dict)
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    bare: Path | None = None
    arm: str | None = None
    gain_std: float | None = None
    tip: str | None = None
    is_warm: bool = False
    calibrated: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class AnalysisInputs:
    """Inputs of an analysis in addition to the samples.

    Attributes
    ----------
    robot : Robot or None
        None if neither an option nor a recording names one.
    knowledge : Knowledge
        Prior knowledge of arm and loads, from the options and the cell.
    arm : ArmConfig or None
        Arm of the cell file, if there is one.
    loaded : LoadedCell or None
    recordings : tuple of Recording
        Recordings of that arm, converted with the valid constants.
    corrections : tuple of Correction
        Constants that were corrected since a recording was made.
    assumed : tuple of Finding
        Assumptions about the inputs, such as the frame of a known load.
    currents : joints whose motor current is in a table
    calibrated : Calibrated or None
        Torque constants of the calibration file, which `read_rows` applies.
    bare_roles : Roles
        Data that the stored identification of the unloaded arm was made from.
    """

    robot: Robot | None
    knowledge: Knowledge
    arm: ArmConfig | None
    loaded: LoadedCell | None
    recordings: tuple[Recording, ...]
    corrections: tuple[Correction, ...] = ()
    assumed: tuple[Finding, ...] = ()
    currents: frozenset[int] = frozenset()
    calibrated: Calibrated | None = None
    bare_roles: Roles = field(default_factory=dict)

    @property
    def load_bounds(self) -> LoadBounds:
        """Largest credible load of this arm."""
        return load_bounds(self.robot, self.arm, trusts_masses=self.knowledge.link_std != np.inf)

    @property
    def model(self) -> Robot:
        """Robot model.

        Raises
        ------
        ConfigError
            Neither an option nor a recording names a robot.
        """
        if self.robot is None:
            raise ConfigError(
                "no robot model: give --cell CELL or --robot R.urdf, or a recording (.h5), which contains its robot"
                " model"
            )
        return self.robot


def collect_inputs(request: ModelRequest, paths: Sequence[Path]) -> AnalysisInputs:
    """Collect the inputs from the options and the recordings among the data files.

    Raises
    ------
    ConfigError
        A robot or cell file cannot be used, or there are several arms and none was named.
    InputError
        A recording or a stored identification of the unloaded arm cannot be used, or was made with another arm.
    """
    recordings = tuple(read(path) for path in paths if is_recording(path))
    return inputs_from_recordings(request, recordings, _current_columns(paths))


def _current_columns(paths: Sequence[Path]) -> frozenset[int]:
    """Return the joints of which a table holds the motor current: its torque is computed with the torque constant."""
    joints: set[int] = set()
    for path in paths:
        if path.is_file() and not is_recording(path):
            with path.open(encoding="utf-8", errors="replace") as file:
                joints.update(map(int, re.findall(r"\bi(\d+)_a\b", file.readline())))
    return frozenset(joints)


def inputs_from_recordings(
    request: ModelRequest, read_ones: Sequence[Recording], currents: frozenset[int] = frozenset()
) -> AnalysisInputs:
    """Collect the inputs from the options and recordings that are already read; see `collect_inputs`.

    `currents` are the joints whose motor current is in a table.
    """
    loaded = None if request.cell is None else load_cell(request.cell)
    arm, robot = _arm_and_robot(request, loaded, read_ones)
    bound = () if arm is None else _bound(read_ones, arm, robot, loaded)
    gravity_m_s2 = STANDARD_GRAVITY_M_S2 if arm is None else arm.gravity_m_s2
    axes = 1 if robot is None else robot.axes
    stored = None if request.bare is None else read_bare(request.bare)
    bare = None if stored is None else stored.bare
    if bare is not None and robot is not None:
        refuse_other_bare(bare, robot, gravity_m_s2)
    of_cell = None if arm is None else arm.link_std
    link_std = parse_inertials(request.inertials) if request.inertials else of_cell
    bounds = load_bounds(robot, arm, trusts_masses=link_std != np.inf)
    measured = _calibrated(request, loaded, arm, [recording for recording, _ in bound])
    if stored is not None:
        # Refuse a stored identification of the unloaded arm with other calibrated torque constants
        for joint in range(1, axes + 1):
            entry = stored.provenance.get(f"J{joint}")
            scale = entry.get("torque_scale") if isinstance(entry, Mapping) else None
            was = float(scale["value"]) if isinstance(scale, Mapping) else 1.0
            now = 1.0 if measured is None else float(measured.scale[joint - 1])
            if not np.isclose(was, now, rtol=1e-6):
                raise InputError(
                    f"{request.bare}: the unloaded arm was identified with a torque of J{joint} scaled by {was:.4g},"
                    f" the calibration in use says {now:.4g}; estimate the samples of the unloaded arm again with the"
                    " same --cell"
                )
    loads = {label: in_last_link(label, load, robot, bounds) for label, load in request.known.items()}
    exact = {label: (load.mass_kg, *load.com_m) for label, load in loads.items() if load.com_m and load.is_exact}
    assumed = (unnamed_frame(label, stated, robot) for label, stated in request.known.items())
    knowledge = Knowledge(
        link_std=link_std,
        known=exact,
        weighed={label: load for label, load in loads.items() if label not in exact},
        parts=request.parts,
        bare=bare,
        gravity_m_s2=gravity_m_s2,
        gain_std=_gain_std(request, arm, axes, (profile_of(read_ones, loaded), currents), measured),
        measured_gain=() if measured is None else tuple(np.isfinite(measured.std).tolist()),
        change=WARM_CHANGE if request.is_warm else 1.0,
    )
    if arm is not None:
        knowledge = replace(
            knowledge,
            efficiency=np.array([axis.gear_efficiency.value for axis in arm.axis]),
            coupling=None if arm.coupling is None else np.array(arm.coupling, dtype=float),
            gear_ratio=np.array([axis.gear_ratio.value for axis in arm.axis]),
        )
    return AnalysisInputs(
        robot=robot,
        knowledge=knowledge,
        arm=arm,
        loaded=loaded,
        recordings=tuple(recording for recording, _ in bound),
        corrections=tuple(dict.fromkeys(correction for _, corrections in bound for correction in corrections)),
        currents=currents,
        assumed=(*filter(None, assumed), *(() if measured is None else measured.findings)),
        calibrated=measured,
        bare_roles={} if stored is None else stored.data_roles,
    )


def _calibrated(
    request: ModelRequest, loaded: LoadedCell | None, arm: ArmConfig | None, recordings: Sequence[Recording]
) -> Calibrated | None:
    """Return the calibration next to the cell file; without a cell file that of the first recording."""
    if arm is None or not request.calibrated:
        return None
    where = f"{recordings[0].path}: @calibration" if request.cell is None else str(calibration_path(request.cell))
    text = recordings[0].calibration if loaded is None else loaded.calibration
    return calibrated(text, where, arm, serial_numbers(recordings, arm.name), datetime.now(UTC))


def _gain_std(
    request: ModelRequest,
    arm: ArmConfig | None,
    axes: int,
    source: tuple[Callable[[str], DriveProfile], frozenset[int]],
    measured: Calibrated | None,
) -> tuple[float, ...] | None:
    """Return the standard deviations of the torque constants: requested, else calibrated, else stated."""
    if request.gain_std is not None:
        return (request.gain_std,) * axes
    if arm is None:
        return None
    stated = constants_std(arm, *source)
    return stated if measured is None else measured.gain_std(stated, WARM_CHANGE if request.is_warm else 1.0)


def constants_std(
    arm: ArmConfig, profile: Callable[[str], DriveProfile], currents: frozenset[int] = frozenset()
) -> tuple[float, ...]:
    """Return the relative standard deviations of the torque constants, or of the torque that the drives report.

    The torque of joints in `currents` is computed from the current of a table, whatever their drives report.
    """
    return tuple(_constant_std(axis, profile, joint in currents) for joint, axis in enumerate(arm.axis, 1))


def _constant_std(axis: AxisConfig, profile: Callable[[str], DriveProfile], of_current: bool) -> float:
    constant = axis.torque_constant_nm_per_a
    if constant.std_percent is None and not of_current and not uses_torque_constant(axis, profile):
        return REPORTED_STD_PERCENT / 100.0
    return constant.trust_percent / 100.0


def uses_torque_constant(axis: AxisConfig, profile: Callable[[str], DriveProfile]) -> bool:
    """Return whether the torque of an axis was computed with the constant of the cell file."""
    try:
        return profile(axis.profile).needs_torque_constant
    except ProfileError:
        # a table needs no drive profile; its torque was computed before, with this constant
        return True


def profile_of(recordings: Sequence[Recording], loaded: LoadedCell | None) -> Callable[[str], DriveProfile]:
    """Return a function from name to drive profile: recorded, else next to the cell file, else of the package.

    Raises
    ------
    ProfileError
        When called: the profile is unreadable or missing.
    """
    texts = recordings[0].profiles if recordings else {}

    @cache  # a profile with a data sheet takes a while to read, and all axes may have the same one
    def find(name: str) -> DriveProfile:
        if name in texts:
            return parse_profile(texts[name], name)
        return find_profile(name, Path()) if loaded is None else loaded.profile(name)

    return find


def _bound(
    recordings: Sequence[Recording], arm: ArmConfig, robot: Robot | None, loaded: LoadedCell | None
) -> list[tuple[Recording, tuple[Correction, ...]]]:
    """Bind recordings to the cell file, else to the cell of the first one; refuse recordings of another arm."""
    bound: list[tuple[Recording, tuple[Correction, ...]]] = []
    for recording in recordings:
        bound.append(bind(recording, recordings[0].cell if loaded is None else loaded.cell, arm))
        if loaded is None and (corrections := bound[-1][1]):
            raise InputError(
                f"{recording.path}: {corrections[0]}: {recordings[0].path.name} was recorded with another"
                " constant; name the cell file with the valid constants by --cell"
            )
        _refuse_other_kinematics(recording, arm, robot)
    refuse_other_drives(recordings, arm.name)
    return bound


def _refuse_other_kinematics(recording: Recording, arm: ArmConfig, robot: Robot | None) -> None:
    config = arm_config(recording.cell, arm.name, str(recording.path))
    if robot is None or not (recording.robot_text or config.dh is not None):
        return
    recorded = robot_from_text(config, recording.robot_text, f"{recording.path}: robot")
    difference = kinematic_difference(recorded, robot)
    if difference:
        raise InputError(
            f"{recording.path}: was recorded with robot '{recorded.name}', and in robot '{robot.name}', {difference};"
            " name the cell or robot of the recording"
        )


def _arm_and_robot(
    request: ModelRequest, loaded: LoadedCell | None, recordings: Sequence[Recording]
) -> tuple[ArmConfig | None, Robot | None]:
    if loaded is not None:
        arm = arm_named(loaded, request.arm)
        return arm, _urdf(request) or arm_robot(loaded, _ended(arm, request.tip))
    if recordings:
        first = recordings[0]
        stored = LoadedCell(cell=first.cell, text=first.cell_text, folder=first.path.resolve().parent)
        arm = arm_named(stored, request.arm)
        robot = _urdf(request)
        return arm, robot or robot_from_text(_ended(arm, request.tip), first.robot_text, f"{first.path}: robot")
    return None, _urdf(request)


def _urdf(request: ModelRequest) -> Robot | None:
    """Return the robot of the --robot option."""
    if request.robot is None:
        return None
    return robot_from_urdf(read_urdf(request.robot), str(request.robot), request.tip)


def _ended(arm: ArmConfig, tip: str | None) -> ArmConfig:
    """Return the arm with another last link."""
    return arm if tip is None else arm.model_copy(update={"tip": tip})


def read_bare(path: Path) -> Result:
    """Return an earlier result that holds an identification of the unloaded arm.

    Raises
    ------
    InputError
        The file is unreadable, holds no such identification, or holds effects as well.
    """
    result = read_result(path)
    bare = result.bare
    if result.effects:
        names = ", ".join(dict.fromkeys(effect.name for effect in result.effects))
        raise InputError(
            f"{path}: its identification of the unloaded arm includes effects ({names}), which --bare cannot use"
        )
    if bare is None:
        raise InputError(
            f"{path}: holds no identification of the unloaded arm; estimate samples of the unloaded arm with --json"
            " and name that file"
        )
    if not all(np.isfinite(part).all() for part in (bare.value, bare.gravity_m_s2, bare.covariance, bare.combination)):
        raise InputError(
            f"{path}: the identification of the unloaded arm lacks numbers; estimate the samples of the unloaded arm"
            " again"
        )
    return result


def read_rows(paths: Sequence[Path], about: AnalysisInputs) -> Table:
    """Read the samples of all data files, the same files as for `collect_inputs`.

    Raises
    ------
    InputError
        A file cannot be used, its number of axes differs from that of the robot, or its torques are in another unit.
    """
    axes = None if about.loaded is None or about.arm is None else AxisConversion.from_arm(about.arm)
    table = read_data(paths, about.recordings, axes)
    if about.calibrated is not None and table.axes == len(about.calibrated.scale):
        table = table.with_torque_scaled(about.calibrated.scale)
    if about.robot is not None and table.axes != about.robot.axes:
        raise InputError(
            f"{table.file[0]}: the data have {table.axes} axes, but robot '{about.robot.name}' has"
            f" {about.robot.axes}; name the measured robot{or_another_tip(about.robot, table.axes)}"
        )
    table = without_constant_torques(table)
    if about.robot is not None and about.knowledge.link_std != np.inf:
        refuse_small_torques(table, about.robot, about.knowledge.gravity_m_s2)
    return table


def split_validation(table: Table) -> tuple[Table, Table | None]:
    """Split the table into fitted samples and visits of validation poses; None without validation poses."""
    marks = table.extra.get(VALIDATION)
    if marks is None:
        return table, None
    fresh = np.nan_to_num(np.asarray(marks, dtype=float)) > 0.5
    if not fresh.any() or fresh.all():
        return table, None
    return table.take(~fresh), table.take(fresh)
