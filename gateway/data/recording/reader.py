"""Read a recording (HDF5): measured visits and periods, and the cell they were measured on.

The torque is recomputed from the raw words, with the constants read from the drives and the cell and profile texts of
the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from drives.scaling import Constants
from gateway.cell.config import ArmConfig, parse_cell
from gateway.data.period import KINDS, Period, harmonics_of, why_aliased
from gateway.data.recording.binding import torque_units
from gateway.data.recording.hdf5_text import Hdf5Group, open_recording
from gateway.data.recording.recorded import SIDES, ArmRecording, Recording, arm_config
from gateway.data.recording.seal import refuse_damaged
from gateway.data.visit import NO_WORD, Purpose, RestPose, Visit
from gateway.errors import ConfigError, InputError

__all__ = ["SCHEMA", "ArmRecording", "Recording", "read"]

SCHEMA = 1
FINISHED = "success"
STATUSES = (FINISHED, "abort", "fail")
#: A period is a whole number of SYNCs to within this share of one SYNC.
WHOLE: Final = 0.25
#: Relative difference between a stored torque and the one that follows from its raw word.
SAME_TORQUE = 1e-6


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
    read_visits = [_visit(visits.inside(name), _number(visits, name, "visit"), axes, units) for name in visits.names()]
    measured = tuple(sorted(read_visits, key=lambda visit: visit.number))
    # the planned poses, and those chosen during the recording
    poses = {pose.number: pose for pose in _poses(place, axes)}
    for visit in measured:
        purpose: Purpose = "validation" if visit.purpose == "validation" else "fit"
        poses.setdefault(visit.pose, RestPose(visit.pose, tuple(visit.target_rad.tolist()), purpose))
    return ArmRecording(
        name=config.name,
        poses=tuple(poses.values()),
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


def _number(place: Hdf5Group, name: str, what: str) -> int:
    if not (name.isascii() and name.isdigit() and len(name) < 10):
        raise place.refuse(name, f"is not a number of a {what}")
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


def read_excitations(place: Hdf5Group) -> dict[int, dict[str, Any]]:
    """Return the excitations by fingerprint, as plain values; empty if the arm was not moved.

    Raises
    ------
    InputError
        An excitation is not JSON, or its name is not a number.
    """
    if not place.has("excitations"):
        return {}
    known = place.inside("excitations")
    found: dict[int, dict[str, Any]] = {}
    for name in known.group.attrs:
        if not (name.isascii() and name.isdigit() and len(name) <= 10):
            raise known.refuse(f"@{name}", "is not a number of an excitation")
        found[int(name)] = known.document(name, dict, {})
    return found


def read_periods(
    place: Hdf5Group, axes: int, torque_unit_nm: np.ndarray | None, excitations: dict[int, dict[str, Any]]
) -> tuple[Period, ...]:
    """Return the periods of an arm in measurement order.

    Raises
    ------
    InputError
        A period has invalid attributes, or lacks a SYNC although it is marked complete.
    """
    if not place.has("periods"):
        return ()
    periods = place.inside("periods")
    found = [
        _period(periods.inside(name), _number(periods, name, "period"), axes, torque_unit_nm, excitations)
        for name in periods.names()
    ]
    return tuple(sorted(found, key=lambda period: period.number))


def _period(
    place: Hdf5Group,
    number: int,
    axes: int,
    torque_unit_nm: np.ndarray | None,
    excitations: dict[int, dict[str, Any]],
) -> Period:
    arrays = read_samples(place, axes, torque_unit_nm)
    arrays["target_rad"] = finite(place, "target_rad", axes)
    require_length(place, arrays, len(arrays["sync_index"]))
    period = Period(
        number=number,
        load=place.label("load"),
        excitation=place.integer("excitation"),
        name=place.text("name"),
        kind=place.text("kind"),
        joint=place.integer("joint"),
        period=place.integer("period"),
        speed=place.number("speed"),
        period_s=place.number("period_s"),
        complete=bool(place.integer("complete")),
        incomplete_epochs=place.integer("incomplete_epochs", 0),
        **arrays,
        temperature_c=place.optional_numbers("temperature_c", axes),
    )
    if period.kind not in KINDS or not 0 <= period.joint <= axes or period.period < 1:
        raise place.refuse("", "load, kind, joint or period has an invalid value")
    if not (0 < period.speed <= 1 and period.period_s > 0):
        raise place.refuse("@speed", "speed must be above 0 and at most 1, period_s above 0")
    if period.excitation not in excitations:
        raise place.refuse("@excitation", f"is {period.excitation}; the file does not contain that excitation")
    if period.complete:
        _require_whole(place, period, harmonics_of(excitations[period.excitation]))
    return period


def _require_whole(place: Hdf5Group, period: Period, harmonics: int) -> None:
    """Check that a complete period contains every SYNC, a whole number of them, and enough for its harmonics."""
    steps = np.diff(period.sync_index)
    if (steps != 1).any():
        at = int(np.argmax(steps != 1))
        one, two = period.sync_index[at : at + 2].tolist()
        raise place.refuse("sync_index", f"SYNC {one} is followed by {two}, but the period is marked complete")
    n = len(period)
    apart_s = float(period.time_s[-1] - period.time_s[0]) / max(n - 1, 1)
    if not (apart_s > 0 and abs(n * apart_s - period.period_s) < WHOLE * apart_s):
        raise place.refuse(
            "@period_s",
            f"is {period.period_s:g} s, and {n} SYNCs that are {apart_s:g} s apart are {n * apart_s:g} s: a period is "
            "a whole number of SYNCs",
        )
    reason = why_aliased(n, harmonics)
    if reason is not None:
        raise place.refuse("time_s", reason)


def read_samples(place: Hdf5Group, axes: int, torque_unit_nm: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return the sample arrays by the field names of `Visit` and `Period`.

    Parameters
    ----------
    place : Hdf5Group
        Group of the visit or period.
    axes : int
    torque_unit_nm : array of shape (N,) or None
        Motor torque per bit of the torque word; None = not in the file.

    Raises
    ------
    InputError
        Missing, of another shape, not finite, not one row per sample, no sample, or a torque that disagrees with
        its raw words.
    """

    def words(name: str) -> np.ndarray:
        return place.array(name, axes, "iu").astype(np.int64)

    torque_word, stored_nm = words("torque_permille"), finite(place, "motor_torque_nm", axes)
    motor_nm = stored_nm if torque_unit_nm is None else torque_word * torque_unit_nm
    if motor_nm.shape != stored_nm.shape or not np.allclose(motor_nm, stored_nm, rtol=SAME_TORQUE, atol=1e-12):
        raise place.refuse("motor_torque_nm", "disagrees with torque_permille and the constants of the file")
    absent = np.full(torque_word.shape, NO_WORD, dtype=np.int64)
    arrays = {
        "statusword": words("statusword"),
        "position_count": words("position_count"),
        "torque_word": torque_word,
        "current_word": words("current_permille") if place.has("current_permille") else absent,
        "velocity_word": words("velocity_word") if place.has("velocity_word") else absent,
        "q_rad": finite(place, "q_rad", axes),
        "motor_torque_nm": motor_nm,
        "joint_torque_nm": finite(place, "joint_torque_nm", axes),
        "motor_current_a": place.array("motor_current_a", axes, "f")
        if place.has("motor_current_a")
        else absent * np.nan,
        "sync_index": place.array("sync_index", None, "iu").astype(np.int64),
        "time_s": finite(place, "time_s", None),
    }
    require_length(place, arrays, len(torque_word))
    if not len(torque_word):
        raise place.refuse("", "contains no sample")
    if (np.diff(arrays["sync_index"]) <= 0).any():
        raise place.refuse("sync_index", "does not increase")
    return arrays


def finite(place: Hdf5Group, name: str, columns: int | None) -> np.ndarray:
    """Return a dataset of finite floats; raise `InputError` if a value is not finite."""
    values = place.array(name, columns, "f").astype(float)
    if not np.isfinite(values).all():
        raise place.refuse(name, "contains a value that is not finite")
    return values


def require_length(place: Hdf5Group, arrays: dict[str, np.ndarray], n_samples: int) -> None:
    """Check that arrays have one row per sample."""
    for name, values in arrays.items():
        if len(values) != n_samples:
            raise place.refuse(name, f"has {len(values)} samples, torque_permille has {n_samples}")
