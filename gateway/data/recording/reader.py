"""Read a recording (HDF5): measured visits and periods, and the cell they were measured on.

The torque is recomputed from the raw words, with the constants read from the drives and the cell and profile texts of
the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drives.scaling import Constants
from gateway.cell.config import ArmConfig, parse_cell
from gateway.data.recording.binding import torque_units
from gateway.data.recording.hdf5_text import Hdf5Group, open_recording
from gateway.data.recording.period_reader import read_excitations, read_periods
from gateway.data.recording.recorded import SIDES, ArmRecording, Recording, arm_config
from gateway.data.recording.samples import read_samples
from gateway.data.recording.seal import refuse_damaged
from gateway.data.rest_pose import Purpose, RestPose
from gateway.data.visit import Visit
from gateway.errors import ConfigError, InputError

__all__ = ["SCHEMA", "ArmRecording", "Recording", "read"]

SCHEMA = 1
FINISHED = "success"
STATUSES = (FINISHED, "abort", "fail")


def read(path: Path) -> Recording:
    """Read a recording; of a killed run, up to its last complete visit or period.

    Raises
    ------
    InputError
        With file and object: not HDF5, truncated, damaged, of another schema, or a torque that disagrees with
        its raw words.
    """
    path = Path(path)
    try:
        refuse_damaged(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    return read_unsealed(path)


def read_unsealed(path: Path) -> Recording:
    """Read a recording without checking its checksum; otherwise as `read`."""
    with open_recording(path) as root:
        schema = root.integer("schema")
        if schema != SCHEMA:
            raise root.refuse("@schema", f"is {schema}; this software reads schema {SCHEMA}")
        status = root.text("exit_status")
        if status not in STATUSES:
            raise root.refuse("@exit_status", f"is '{status}', one of {', '.join(STATUSES)} expected")
        cell_text = root.text("cell")
        try:
            cell = parse_cell(cell_text, root.where("@cell"))
        except ConfigError as error:
            raise InputError(str(error)) from error
        profiles = root.document("profiles", dict, {})
        arms = root.inside("arms")
        return Recording(
            path=path,
            created=root.text("created"),
            software=root.text("software"),
            exit_status=status,
            reason=root.text("reason"),
            cell=cell,
            cell_text=cell_text,
            robot_text=root.text("robot"),
            profiles=profiles,
            calibration=root.text("calibration", ""),
            arms=tuple(_arm(arms.inside(name), arm_config(cell, name, str(path)), profiles) for name in arms.names()),
        )


def _arm(place: Hdf5Group, config: ArmConfig, profiles: dict[str, str]) -> ArmRecording:
    constants = tuple(_constants(place, item) for item in place.document("constants", list, []))
    axes = len(config.axis)
    if constants and len(constants) != axes:
        raise place.refuse("@constants", f"constants of {axes} drives expected")
    units = torque_units(config, profiles, constants, place.where()) if constants else None
    excitations = read_excitations(place)
    visits = place.inside("visits")
    read_visits = [_visit(visits.inside(name), _number(visits, name), axes, units) for name in visits.names()]
    measured = tuple(sorted(read_visits, key=lambda visit: visit.number))
    return ArmRecording(
        name=config.name,
        poses=_with_measured(_poses(place, axes), measured),
        visits=measured,
        constants=constants,
        identities=place.document("identities", list, []),
        ledger=place.document("ledger", list, []),
        bus_statistics=place.document("bus_statistics", dict, {}),
        periods=read_periods(place, axes, units, excitations),
        excitations=excitations,
    )


def _constants(place: Hdf5Group, item: Any) -> Constants:
    try:
        values = {name: None if value is None else float(value) for name, value in item.items()}
        return Constants(**values)  # type: ignore[arg-type]
    except (AttributeError, TypeError, ValueError) as error:
        raise place.refuse("@constants", f"is damaged: {error}") from error


def _poses(place: Hdf5Group, axes: int) -> tuple[RestPose, ...]:
    if not place.has("pose_q_rad"):
        return ()
    q_rad = place.array("pose_q_rad", axes, "f")
    numbers, validation = place.array("pose_number", None, "iu"), place.array("pose_validation", None, "iu")
    if not len(q_rad) == len(numbers) == len(validation):
        raise place.refuse("pose_number", "number of poses differs from pose_q_rad")
    return tuple(
        RestPose(int(number), tuple(row), "validation" if judged else "fit")
        for number, row, judged in zip(numbers, q_rad.tolist(), validation, strict=True)
    )


def _with_measured(asked: Sequence[RestPose], visits: Sequence[Visit]) -> tuple[RestPose, ...]:
    """Return the planned poses and those chosen during the recording."""
    poses = {pose.number: pose for pose in asked}
    for visit in visits:
        purpose: Purpose = "validation" if visit.purpose == "validation" else "fit"
        poses.setdefault(visit.pose, RestPose(visit.pose, tuple(visit.target_rad.tolist()), purpose))
    return tuple(poses.values())


def _number(visits: Hdf5Group, name: str) -> int:
    if not (name.isascii() and name.isdigit() and len(name) < 10):
        raise visits.refuse(name, "is not a number of a visit")
    return int(name)


def _visit(place: Hdf5Group, number: int, axes: int, torque_unit_nm: np.ndarray | None) -> Visit:
    visit = Visit(
        number=number,
        load=place.label("load"),
        pose=place.integer("pose"),
        purpose=place.text("purpose", "fit"),
        approach=place.integer("approach"),
        complete=bool(place.integer("complete")),
        incomplete_epochs=place.integer("incomplete_epochs", 0),
        direction=np.sign(place.numbers("direction", axes, np.zeros(axes))).astype(np.int8),
        target_rad=place.numbers("target_rad", axes, np.zeros(axes)),
        **read_samples(place, axes, torque_unit_nm),
        gravity_nm=place.numbers("gravity_nm", axes) if "gravity_nm" in place.group.attrs else None,
        friction_band_nm=place.numbers("friction_band_nm", axes) if "friction_band_nm" in place.group.attrs else None,
        temperature_c=place.optional_numbers("temperature_c", axes),
    )
    if visit.purpose not in ("fit", "validation") or visit.approach not in SIDES:
        raise place.refuse("", "load, purpose or approach has an invalid value")
    return visit
