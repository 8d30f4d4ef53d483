"""Rows of the fleet store, one per check: from a recording, a result, or a repeated estimation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from gateway.data.recording.reader import read
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.errors import DataUnusable, InputError
from gateway.estimate import run
from gateway.fleet.columns import ESTIMATE, RECORDING, RESULT, TEMPERATURE, RobotName, axis_columns, moment, robot_name
from gateway.pipeline.inputs import ModelRequest, inputs_from_recordings, read_rows
from gateway.result.origin import drives_of, file_sha256, software
from gateway.result.result import LoadResult, NuisanceResult, Outcome, Result, read_result
from gateway.result.values import plain_values

Row = dict[str, Any]
#: Earliest plausible recording time; an earlier one shows a clock that was never set.
EARLIEST: Final = datetime(2000, 1, 1, tzinfo=UTC)
#: By how much the clock of a robot may be ahead of the clock here [s].
AHEAD_S: Final = 86400.0
_ZERO_OFFSET: Final = "joint_zero_offset"
#: Standard deviation of a gain over that of its constant, below which the data were informative.
_INFORMED_SHARE: Final = 0.9
#: A result does not state how well the constants were known: a gain counts as assumed where its standard deviation is
#: nearly that of the axis that is known worst, and its value nearly none.
_LIKE_ASSUMED: Final = 0.9
_UNMOVED: Final = 0.02


def rows_of_recording(path: Path, now: datetime) -> list[Row]:
    """Return one row per arm of a recording, without estimates.

    Raises
    ------
    InputError
        The recording is unusable, or does not state its time.
    """
    recording = read(path)
    at = _when(recording.created, str(path))
    sha256 = file_sha256(path)
    return [
        _row(
            _name(recording, arm),
            at,
            now,
            kind=RECORDING,
            source=path.name,
            sha256=sha256,
            line=number,
            recordings=[sha256],
            software=recording.software,
            duration_s=_duration_s(arm),
        )
        for number, arm in enumerate(recording.arms)
    ]


def rows_of_result(path: Path, now: datetime) -> list[Row]:
    """Return the row of a result file.

    Raises
    ------
    InputError
        It cannot be used, or names no cell, or not when its data were recorded.
    """
    result = read_result(path)
    drawn = result.data
    if drawn is None or not drawn.cell or not drawn.arm:
        raise InputError(
            f"{path}: does not state its robot: it was estimated without recording and cell; estimate again"
            " with --cell, or from the recording"
        )
    recorded = [source for source in drawn.sources if source.created]
    if not recorded:
        raise InputError(f"{path}: does not state when its data were recorded; give the recording, or a summary table")
    at = _when(str(recorded[0].created), str(path))
    name = robot_name(drawn.cell, drawn.arm, [drive.serial_number for drive in drawn.drives])
    reported = _row(
        name,
        at,
        now,
        kind=RESULT,
        source=path.name,
        sha256=file_sha256(path),
        recordings=[source.sha256 for source in recorded if source.sha256],
        software=drawn.software or "",
    )
    return [reported | numbers_of(result)]


def estimated_rows(path: Path, sha256: str, now: datetime) -> list[Row]:
    """Repeat the estimation of a recording and return one row per arm; a failure is stored as its reason.

    Raises
    ------
    InputError
        It cannot be read any more.
    """
    recording = read(path)
    at = _when(recording.created, str(path))
    rows: list[Row] = []
    for number, arm in enumerate(recording.arms):
        reported = _row(
            _name(recording, arm),
            at,
            now,
            kind=ESTIMATE,
            source=path.name,
            sha256=sha256,
            line=number,
            recordings=[sha256],
            software=software(),
            duration_s=_duration_s(arm),
        )
        try:
            about = inputs_from_recordings(ModelRequest(arm=arm.name), (recording,))
            table = read_rows([path], about)
            reported |= numbers_of(run(table, about.model, about.knowledge), about.knowledge.gain_std)
            reported[TEMPERATURE] = table.temperature_c.mean(axis=0).tolist()
        except (DataUnusable, InputError) as error:
            reported["failing"] = [f"cannot be estimated: {error}"]
        rows.append(reported)
    return rows


def numbers_of(result: Result, gain_std: Sequence[float] | None = None) -> Row:
    """Return the numbers of a result for every axis and every load.

    Parameters
    ----------
    result : Result
    gain_std : sequence of N floats, optional
        Relative standard deviation of the torque constants before the estimation; with the same one, a gain
        was not measured.
    """
    axes = len(result.friction_band_nm)
    gain, bias = _measured(result.nuisance.get("gain"), gain_std), result.nuisance.get("bias_nm")
    row: Row = {
        "friction_band_nm": plain_values(result.friction_band_nm),
        "loads": [_load(load, _outcome(result, load.label)) for load in result.loads],
        "failing": [f"{each.where}: {each.what}" for each in result.findings if each.severity == "fail"],
    }
    for key, reported in (("gain", gain), ("bias", bias)):
        if reported is not None:
            suffix = "" if key == "gain" else "_nm"
            row[f"{key}{suffix}"], row[f"{key}_std{suffix}"] = plain_values(reported.value), plain_values(reported.std)
    for key in ("coulomb", "viscous"):
        suffix = {"coulomb": "_nm", "viscous": "_nm_s_rad"}[key]
        for column in (f"{key}{suffix}", f"{key}_std{suffix}"):
            values = {axis.joint: float(getattr(axis, column)) for axis in result.motion}
            row[column] = plain_values([values.get(joint, math.nan) for joint in range(1, axes + 1)])
    offsets = {each.joints[0]: each for each in result.effects if each.name == _ZERO_OFFSET and each.joints}
    for column, part in (("zero_offset_rad", "parameters"), ("zero_offset_std_rad", "std")):
        offsets_by_joint = {
            joint: float(getattr(each, part).get("offset_rad", math.nan)) for joint, each in offsets.items()
        }
        row[column] = plain_values([offsets_by_joint.get(joint, math.nan) for joint in range(1, axes + 1)])
    return row


def _measured(gain: NuisanceResult | None, gain_std: Sequence[float] | None) -> NuisanceResult | None:
    """Return the gains that the data determine; a gain is identifiable only with load torque."""
    if gain is None or not gain.value:
        return gain
    value, std = np.array(gain.value), np.array(gain.std)
    if gain_std is not None:
        reported = std < _INFORMED_SHARE * np.asarray(gain_std)
    else:
        reported = (std < _LIKE_ASSUMED * np.nanmax(std)) | (np.abs(value) > _UNMOVED * std)
    return NuisanceResult(
        tuple(np.where(reported, value, np.nan).tolist()), tuple(np.where(reported, std, np.nan).tolist())
    )


def clock_fault(at: datetime, now: datetime) -> str | None:
    """Return why a time is implausible; None where it is plausible."""
    if at < EARLIEST:
        return f"its time is {at:%Y-%m-%d}: the clock was never set"
    if (at - now).total_seconds() > AHEAD_S:
        return f"its time is {at:%Y-%m-%d %H:%M}, in the future"
    return None


def _when(text: str, where: str) -> datetime:
    try:
        return moment(text)
    except ValueError as error:
        raise InputError(
            f"{where}: '{text}' is not a plausible recording time; set the clock and record again"
        ) from error


def _row(name: RobotName, at: datetime, now: datetime, **reported: Any) -> Row:
    row: Row = dict.fromkeys(axis_columns())
    row |= {
        "robot": name.key,
        "month": f"{at:%Y-%m}",
        "time_utc": at.replace(tzinfo=None),
        "duration_s": math.nan,
        "cell": name.cell,
        "arm": name.arm,
        "serial_numbers": list(name.serial_numbers),
        "line": 0,
        "clock": clock_fault(at, now),
        "loads": [],
        "failing": [],
    }
    return row | reported


def _name(recording: Recording, arm: ArmRecording) -> RobotName:
    identities = [each if isinstance(each, Mapping) else {} for each in arm.identities]
    return robot_name(recording.cell.name, arm.name, [drive.serial_number for drive in drives_of(identities)])


def _duration_s(arm: ArmRecording) -> float:
    ends = [float(each.time_s[end]) for each in (*arm.visits, *arm.periods) if len(each.time_s) for end in (0, -1)]
    return max(ends) - min(ends) if ends else 0.0


def _load(load: LoadResult, outcome: Outcome | None) -> Row:
    refused = load.refused is not None
    return {
        "program": load.label,
        "mass_kg": plain_values(load.mass_kg),
        "mass_std_kg": plain_values(load.mass_std_kg),
        "com_m": plain_values(load.com_m),
        "com_std_m": plain_values(load.com_std_m),
        "outcome": "fail" if refused else outcome,
    }


def _outcome(result: Result, label: str) -> Outcome | None:
    """Return the outcome of the load check; the worst one of several loads."""
    said = [each.outcome for each in result.acceptance if each.load == label]
    for worst in ("fail", "cannot tell", "pass"):
        if worst in said:
            return worst
    return None
