"""Complete a result for its file: add what the report draws, and the source of every constant up to the joint torque.

Its loads are compared with the operator's expectation and with the ratings of the cell file.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from drives.errors import ProfileError
from drives.profile import Constant, DriveProfile, Rated, Signal, current_factor
from drives.scaling import Constants
from gateway.cell.config import ArmConfig, AxisConfig
from gateway.data.recording.reader import FINISHED
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.table import Table, is_recording
from gateway.identify.load_estimate import load_result, refused_findings, refused_load
from gateway.identify.prior_loads import BARE_LABEL
from gateway.pipeline.inputs import AnalysisInputs, profile_of
from gateway.pipeline.torque_size import constant_torques
from gateway.report.collect import drawn_poses, flange_spread
from gateway.result.acceptance import Expected, Rating, accepted, check_expected, not_hung
from gateway.result.drawn import Drawn, DrawnPose, DrawnSource
from gateway.result.numerals import half_width
from gateway.result.origin import DriveOrigin, drives_of, file_sha256, in_words, software
from gateway.result.result import Finding, LoadResult, Result

#: Characters in which two spellings of one label may differ.
_SEPARATORS: Final = re.compile(r"[\s_-]+")
Entry = dict[str, Any]


def finalize(
    result: Result, about: AnalysisInputs, table: Table, paths: Sequence[Path], operator: str | None = None
) -> Result:
    """Add the context that a reader of the result file needs in addition to the numbers.

    Parameters
    ----------
    result : Result
        Of an estimation or a diagnosis.
    about : AnalysisInputs
        Inputs of the estimation.
    table : Table
        All samples that were read.
    paths : sequence of Path
        The data files.
    operator : str, optional
        Name of the operator.

    Returns
    -------
    Result
        Result with the data for the report and the provenance of every constant.
    """
    result = _with_parts(_without_incredible(result, about), about.knowledge.parts)
    drawn = Drawn() if result.data is None else result.data
    roles = drawn.role or (() if result.rows is None else ("fit",) * len(result.rows.load))
    constants = _provenance(about)
    return replace(
        result,
        findings=(
            *result.findings,
            *constant_torques(table),
            *about.assumed,
            # constants that were corrected since the recording
            *(
                Finding("info", f"J{each.joint}", f"{each.what}: recomputed with the constants of the cell file", "")
                for each in about.corrections
            ),
            *data_findings(about, table),
            *not_hung(result.loads),
        ),
        provenance={**constants, **result.provenance},
        data=replace(
            drawn,
            created=in_words(datetime.now(UTC)),
            software=software(),
            cell=about.loaded.cell.name if about.loaded is not None else _cell_of(about.recordings),
            arm=None if about.arm is None else about.arm.name,
            flange_source=None if about.arm is None else about.arm.flange_origin,
            operator=operator,
            drives=_drives(about),
            sources=tuple(_source(path, about.recordings, table) for path in paths),
            role=roles,
            poses=_poses(result, about, roles),
            flange={} if about.robot is None else flange_spread(about.robot, result.loads),
            bus=_bus(about.recordings, about.arm.name if about.arm is not None else None),
            temperature_c=_temperatures(table),
            torque_limit_nm=() if about.arm is None else tuple(axis.torque_limit_nm for axis in about.arm.axis),
        ),
    )


def _temperatures(table: Table) -> tuple[tuple[float, float], ...]:
    """Return the lowest and highest temperature of every axis [deg C]; empty if none is recorded."""
    recorded = np.isfinite(table.temperature_c)
    if not recorded.any():
        return ()
    low = np.where(recorded, table.temperature_c, np.inf).min(axis=0)
    high = np.where(recorded, table.temperature_c, -np.inf).max(axis=0)
    known = recorded.any(axis=0)
    return tuple(zip(np.where(known, low, np.nan).tolist(), np.where(known, high, np.nan).tolist(), strict=True))


def _without_incredible(result: Result, about: AnalysisInputs) -> Result:
    """Refuse every load that is significantly beyond the capacity of the arm."""

    def held(load: LoadResult) -> LoadResult:
        wrong = about.load_bounds.violation(
            load.mass_kg,
            load.com_m or (),
            half_width(load.mass_std_kg),
            [half_width(std) for std in load.com_std_m or (0.0, 0.0, 0.0)],
        )
        return replace(load_result(refused_load(load.label, wrong), about.robot), frame=load.frame) if wrong else load

    loads = tuple(map(held, result.loads))
    refused = [load for load, before in zip(loads, result.loads, strict=True) if load is not before]
    if not refused:
        return result
    advice = "check the units of data and --known (kg, m, Nm, rad), and rated_load_kg of the cell file"
    findings = (*result.findings, *refused_findings(refused, advice))
    return replace(result, loads=loads, after=replace(result.after, loads=loads), findings=findings)


def _with_parts(result: Result, parts: Mapping[str, tuple[str, str]]) -> Result:
    """Refuse each part of a refused load, and report of which loads the others are the difference."""
    loads, findings = {load.label: load for load in result.loads}, list(result.findings)
    for name, pair in parts.items():
        gone = [label for label in pair if label in loads and loads[label].refused]
        if gone:
            refused = load_result(refused_load(name, f"load '{gone[0]}' is refused"), None)
            loads[name] = replace(refused, frame=loads[gone[0]].frame)
            findings += refused_findings([loads[name]], f"see what is said of load '{gone[0]}'")
        elif name in loads and not loads[name].refused:
            what = f"difference of the loads '{pair[0]}' and '{pair[1]}' in one fit: errors that both share cancel"
            findings.append(Finding("info", f"load {name}", what, ""))
    if not parts:
        return result
    reported = tuple(loads.values())
    return replace(result, loads=reported, findings=tuple(findings), after=replace(result.after, loads=reported))


def data_findings(about: AnalysisInputs, table: Table) -> Iterator[Finding]:
    """Report recordings that were not finished, and labels of loads that differ only in their spelling."""
    for recording in about.recordings:
        if recording.exit_status != FINISHED:
            yield Finding(
                "warn",
                "recording",
                f"{recording.path}: this recording ended with status {recording.exit_status}: {recording.reason}; its"
                " complete visits are used",
                "check whether the cause affected the complete visits too (a collision, a load that slipped, a drive"
                " fault), and complete the recording with `servo-gateway record --resume`",
                "recording_unfinished",
            )
    labels = np.asarray(table.load, dtype=str)
    spellings: dict[str, list[str]] = {}
    for label in np.unique(labels).tolist():
        at = np.flatnonzero(labels == label)
        text = f"'{label}' ({len(at)} rows, the first is {table.where(int(at[0]))})"
        spellings.setdefault(_SEPARATORS.sub("", label.casefold()), []).append(text)
    for similar in spellings.values():
        if len(similar) > 1:
            yield Finding(
                "warn",
                "load labels",
                f"the labels {' and '.join(similar)} differ only in case, spaces, hyphens or underscores; each is"
                " estimated as a load of its own",
                "if they are one load, write one label in all rows; the load is then estimated from all of them",
                "similar_labels",
            )


def _poses(result: Result, about: AnalysisInputs, roles: Sequence[str]) -> tuple[DrawnPose, ...]:
    if result.rows is None or about.robot is None:
        return ()
    return drawn_poses(about.robot, result.rows, result.loads, roles)


def _drives(about: AnalysisInputs) -> tuple[DriveOrigin, ...]:
    """Return the drives of the first recording; later recordings with other drives are refused before."""
    recorded = _recorded_arm(about.recordings, None if about.arm is None else about.arm.name)
    return drives_of(recorded[0][1].identities) if recorded else ()


def _cell_of(recordings: Sequence[Recording]) -> str | None:
    return recordings[0].cell.name if recordings else None


def _source(path: Path, recordings: Sequence[Recording], table: Table) -> DrawnSource:
    count = sum(name == str(path) for name in table.file)
    if not is_recording(path):
        return DrawnSource(str(path), "measured table", count, sha256=file_sha256(path))
    recording = next(item for item in recordings if item.path == path)
    return DrawnSource(str(path), "recording", count, recording.exit_status, recording.created, file_sha256(path))


def _recorded_arm(recordings: Sequence[Recording], name: str | None) -> list[tuple[Recording, ArmRecording]]:
    return [(item, arm) for item in recordings for arm in item.arms if name in (None, arm.name)]


def _bus(recordings: Sequence[Recording], name: str | None) -> tuple[dict[str, str | int | float | None], ...]:
    """Return one line per recorded arm: the bus counters of its last run."""
    lines: list[dict[str, str | int | float | None]] = []
    for recording, arm in _recorded_arm(recordings, name):
        statistics = arm.bus_statistics
        if statistics:
            lines.append({"run": f"{recording.path.name}, {arm.name}", **_bus_line(statistics)})
    return tuple(lines)


def _bus_line(statistics: Mapping[str, Any]) -> dict[str, int | float]:
    sdo = [item for item in statistics.get("sdo") or [] if isinstance(item, Mapping)]
    slowest = max((item.get("max_s") or 0.0 for item in sdo), default=None)
    line = {
        "SYNC cycles": statistics.get("cycles"),
        "incomplete": statistics.get("incomplete"),
        "late": statistics.get("late"),
        "planned load [%]": _rounded(statistics.get("bus_load_planned_percent"), 1.0),
        "measured load [%]": _rounded(statistics.get("bus_load_measured_percent"), 1.0),
        "SDO slowest [ms]": _rounded(slowest, 1000.0),
        "jitter p99 [ms]": _rounded(statistics.get("jitter_p99_s"), 1000.0),
        "EMCY": statistics.get("emcy_count"),
        "foreign frames": sum((statistics.get("foreign") or {}).values()),
    }
    return {key: value for key, value in line.items() if value is not None}


def _rounded(value: float | None, scale: float) -> float | None:
    return None if value is None else round(scale * value, 2)


def _provenance(about: AnalysisInputs) -> dict[str, Any]:
    """Return the source of every constant: the cell file, or the recording where the drives were read."""
    if about.arm is None:
        return {}
    recorded = _recorded_arm(about.recordings, about.arm.name)
    constants = recorded[0][1].constants if recorded else ()
    try:
        find = profile_of([each for each, _ in recorded], about.loaded)
        profiles = [find(axis.profile) for axis in about.arm.axis]
    except ProfileError:
        # a table needs no drive profile; its torque was computed before
        return {}
    found = dict(provenance(about.arm, profiles, constants, about.currents))
    measured = {} if about.calibrated is None else about.calibrated.provenance
    return {joint: entries | measured.get(joint, {}) for joint, entries in found.items()}


def provenance(
    arm: ArmConfig,
    profiles: Sequence[DriveProfile],
    constants: Sequence[Constants] = (),
    currents: Container[int] = (),
) -> dict[str, dict[str, Entry]]:
    """Constants of every axis with value, unit and source.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
        In the order of the axes.
    constants : sequence of Constants, one per axis
        What was read from the drives; empty if no drive was asked.
    currents : container of int
        Joints whose torque is computed from the motor current of a table.

    Returns
    -------
    dict
        "J1" to "JN" -> name -> {"value", "unit", "source"}.
    """
    read = list(constants) or [None] * len(arm.axis)
    return {
        f"J{joint}": _axis(*axis, joint in currents)
        for joint, axis in enumerate(zip(arm.axis, profiles, read, strict=True), start=1)
    }


def _axis(axis: AxisConfig, profile: DriveProfile, read: Constants | None, of_current: bool) -> dict[str, Entry]:
    entries = {
        "gear_ratio": _entry(axis.gear_ratio.value, "-", axis.gear_ratio.source),
        "gear_efficiency": _entry(axis.gear_efficiency.value, "-", axis.gear_efficiency.source),
    }
    constant = axis.torque_constant_nm_per_a
    used = of_current or profile.needs_torque_constant
    source = constant.source if used else f"{constant.source}; not used, the drive reports torque"
    entries["torque_constant"] = _entry(constant.value, "Nm/A", source)
    signs = f"{axis.position_sign:+d} / {axis.torque_sign:+d}"
    entries["position_sign / torque_sign"] = _entry(signs, "-", "cell file")
    entries["zero_offset"] = _entry(axis.zero_offset_rad, "rad", "cell file")
    entries["torque_object"] = _entry(_object(profile.torque), "", f"profile {profile.name}: {profile.torque.source}")
    if profile.torque.rated is not None:
        unit = "A" if profile.torque.is_current else "Nm"
        entries["rated_value"] = _rated(profile.torque.rated, unit, read)
    if profile.torque.internal_unit_a is not None:
        entries["ampere_per_unit"] = _constant(profile.torque.internal_unit_a, "A")
    if profile.torque.is_current:
        factor = f"profile {profile.name}: drive {profile.torque.current_reference}, constant per "
        entries["current_factor"] = _entry(
            current_factor(profile.torque), "-", f"{factor}{profile.torque.torque_constant_per}"
        )
    counts = profile.position.counts_per_revolution
    if isinstance(counts, Constant):
        entries["counts_per_revolution"] = _constant(counts, "1/rev")
    else:
        where = f"read from drive, 0x{counts.object.index:04X}:{counts.object.subindex:02X}"
        entries["counts_per_revolution"] = _entry(read and read.counts_per_revolution, "1/rev", where)
    return entries


def _entry(value: Any, unit: str, source: str) -> Entry:
    return {"value": value, "unit": unit, "source": source}


def _constant(constant: Constant, unit: str) -> Entry:
    return _entry(constant.value, unit, constant.source)


def _rated(rated: Rated, unit: str, read: Constants | None) -> Entry:
    if rated.object is None:
        return _entry(rated.value, unit, rated.source)
    where = f"read from drive, 0x{rated.object.index:04X}:{rated.object.subindex:02X}, {rated.unit:g} {unit} per bit"
    return _entry(read and read.torque_rated, unit, f"{where}; {rated.source}")


def _object(signal: Signal) -> str:
    return f"0x{signal.object.index:04X}:{signal.object.subindex:02X}, {signal.kind.replace('_', ' ')}"


def ratings(arm: ArmConfig | None) -> tuple[Rating, ...]:
    """Return the ratings of the cell file (load, reach, moment); empty without a cell file."""
    if arm is None:
        return ()
    said = {
        "mass": ("rated load", arm.rated_load_kg),
        "reach": ("rated reach", arm.rated_reach_m),
        "moment": ("rated moment", arm.rated_moment_nm),
    }
    return tuple(
        Rating(what, rated.value, f"{name}, {rated.source}")
        for what, (name, rated) in said.items()
        if rated is not None
    )


def check_against_data(expected: Sequence[Expected], table: Table, about: AnalysisInputs) -> None:
    """Refuse an expectation for a load that is not in the data.

    Raises
    ------
    InputError
        The data lack a load; the message names its label and the files.
    """
    present = set(map(str, table.load)) - {BARE_LABEL, *about.knowledge.known}
    files = ", ".join(dict.fromkeys(table.file))
    check_expected(expected, (*sorted(present), *about.knowledge.parts), f"the data of {files}")


def accept(result: Result, expected: Sequence[Expected], arm: ArmConfig | None) -> Result:
    """Return the result with its loads compared with expectation and rating."""
    return accepted(result, expected, ratings(arm))
