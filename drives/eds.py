"""Electronic data sheets (CiA 306), read through canopen: does the device have what the profile counts on?"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from configparser import Error as ConfigParserError
from pathlib import Path
from typing import Final

from canopen.objectdictionary import ODVariable, datatypes
from canopen.objectdictionary.eds import import_eds

from drives.errors import ProfileError
from drives.objects import OBJECTS
from drives.pdo import VELOCITY_OFFSET
from drives.profile import CountsFromObjects, DriveProfile, ObjectReference, Rated

_TYPES: Final = {
    "u8": datatypes.UNSIGNED8,
    "i8": datatypes.INTEGER8,
    "u16": datatypes.UNSIGNED16,
    "i16": datatypes.INTEGER16,
    "u32": datatypes.UNSIGNED32,
    "i32": datatypes.INTEGER32,
}
_MAX_BYTES: Final = 4_000_000
_MAPPED: Final = ("controlword", "statusword", "target_position", "torque_offset")
_SET: Final = ("mode", "mode_display", "abort_connection_option", "consumer_heartbeat")


def check_eds(profile: DriveProfile, path: Path) -> None:
    """Compare a profile with the data sheet it names.

    Raises
    ------
    ProfileError
        The file cannot be read, or lacks objects, or has them with another type or not for PDOs; all of it at once.
    """
    found = _read(profile, path)
    problems = []
    for reference, mapped in _wanted(profile):
        where = f"{reference.index:04X}:{reference.subindex:02X}"
        entry = found.get((reference.index, reference.subindex))
        if entry is None:
            problems.append(f"{where} is not in it")
        elif entry.data_type != _TYPES[reference.type]:
            problems.append(f"{where} is not of type {reference.type}")
        elif mapped and not entry.pdo_mappable:
            problems.append(f"{where} cannot be mapped to a PDO")
    if problems:
        advice = "correct the profile, or name the data sheet of this firmware"
        what = f"profile {profile.name} and {path.name} contradict each other: {'; '.join(problems)}"
        raise ProfileError(what, advice=advice)


def _read(profile: DriveProfile, path: Path) -> dict[tuple[int, int], ODVariable]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError("it is larger than any data sheet")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            dictionary = import_eds(str(path), node_id=1)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ConfigParserError) as error:
        what = f"profile {profile.name}: data sheet {path} cannot be read: {error}"
        raise ProfileError(what, advice="put the file beside the profile, or remove the key eds") from error
    entries: dict[tuple[int, int], ODVariable] = {}
    for index, thing in dictionary.items():
        members = [thing] if isinstance(thing, ODVariable) else thing.values()
        entries |= {(index, member.subindex): member for member in members}
    return entries


def _wanted(profile: DriveProfile) -> Iterator[tuple[ObjectReference, bool]]:
    """Objects that the master uses, and whether in a PDO."""
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
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        yield counts.object, False
        yield counts.per, False


def _rated(rated: Rated | None) -> Iterator[tuple[ObjectReference, bool]]:
    if rated is not None and rated.object is not None:
        yield rated.object, False
