"""Compare a drive profile with the drive's EDS: objects, data types and PDO mapping that the profile relies on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet
from drives.errors import ProfileError
from drives.objects import OBJECTS
from drives.pdo import VELOCITY_OFFSET
from drives.profile import CountsFromObjects, DriveProfile, ObjectReference, Rated

_MAPPED: Final = ("controlword", "statusword", "target_position", "torque_offset")
_SET: Final = ("mode", "mode_display", "abort_connection_option", "consumer_heartbeat")


def check_eds(profile: DriveProfile, path: Path) -> None:
    """Compare a profile with the EDS that it names.

    Raises
    ------
    ProfileError
        The file cannot be read, or lacks objects, or has them with another type or not for PDOs; all of it at once.
    """
    try:
        sheet = read_sheet(path)
    except ProfileError as error:
        what = f"profile {profile.name}: {error.what}"
        raise ProfileError(what, advice="put the file beside the profile, or remove the key eds") from error
    problems = contradictions(profile, sheet)
    if problems:
        advice = "correct the profile, or name the data sheet of this firmware"
        what = f"profile {profile.name} and {path.name} contradict each other: {'; '.join(problems)}"
        raise ProfileError(what, advice=advice)


def contradictions(profile: DriveProfile, sheet: Sheet) -> list[str]:
    """Return the differences between the objects that the master uses and those in an EDS, as text."""
    problems: list[str] = []
    for reference, mapped in _wanted(profile):
        where = f"{reference.index:04X}:{reference.subindex:02X}"
        entry = sheet.entries.get((reference.index, reference.subindex))
        if entry is None:
            left_out = "".join(f" ({remark})" for remark in sheet.remarks_of(reference.index)[:1])
            problems.append(f"{where} is not in it{left_out}")
        elif sheet.type_of(reference.index, reference.subindex) != reference.type:
            problems.append(f"{where} is not of type {reference.type}")
        elif mapped and not entry.pdo_mappable:
            problems.append(f"{where} cannot be mapped to a PDO")
    return problems


def _wanted(profile: DriveProfile) -> Iterator[tuple[ObjectReference, bool]]:
    """Return the objects that the master uses, each with whether it is mapped to a PDO."""
    for name in (*_MAPPED, *_SET):
        entry = OBJECTS[name]
        reference = ObjectReference.model_validate(
            {"index": entry.index, "subindex": entry.subindex, "type": entry.type}
        )
        yield reference, name in _MAPPED
    yield profile.position.object, True
    for condition in (*profile.safety, *(() if profile.reference is None else (profile.reference,))):
        yield condition.object, False
    for signal in (profile.torque, profile.current):
        if signal is not None:
            yield signal.object, True
            yield from _rated(signal.rated)
    if profile.torque_offset is not None:
        yield from _rated(profile.torque_offset.rated)
    if profile.velocity is not None:
        yield profile.velocity.object, profile.current is not None
    if profile.feedforward is not None:
        yield VELOCITY_OFFSET, True
    if profile.temperature is not None:
        yield profile.temperature.object, False
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        yield counts.object, False
        if counts.per is not None:
            yield counts.per, False


def _rated(rated: Rated | None) -> Iterator[tuple[ObjectReference, bool]]:
    if rated is not None and rated.object is not None:
        yield rated.object, False
