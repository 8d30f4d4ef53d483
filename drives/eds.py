"""Electronic data sheets (CiA 306), read through canopen: does the device have what the profile counts on?"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from configparser import Error as ConfigParserError
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Final

from canopen.objectdictionary import ODVariable, datatypes
from canopen.objectdictionary.eds import import_eds

from drives.errors import ProfileError
from drives.objects import OBJECTS, DataType
from drives.pdo import VELOCITY_OFFSET
from drives.profile import CountsFromObjects, DriveProfile, ObjectReference, Rated

_TYPES: Final[dict[DataType, int]] = {
    "u8": datatypes.UNSIGNED8,
    "i8": datatypes.INTEGER8,
    "u16": datatypes.UNSIGNED16,
    "i16": datatypes.INTEGER16,
    "u32": datatypes.UNSIGNED32,
    "i32": datatypes.INTEGER32,
}
_NAMES: Final[dict[int | None, DataType]] = {code: name for name, code in _TYPES.items()}
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
    """What the master uses by a profile, and a data sheet does not have, or has otherwise: in words."""
    problems = []
    for reference, mapped in _wanted(profile):
        where = f"{reference.index:04X}:{reference.subindex:02X}"
        entry = sheet.entries.get((reference.index, reference.subindex))
        if entry is None:
            problems.append(f"{where} is not in it")
        elif entry.data_type != _TYPES[reference.type]:
            problems.append(f"{where} is not of type {reference.type}")
        elif mapped and not entry.pdo_mappable:
            problems.append(f"{where} cannot be mapped to a PDO")
    return problems


@dataclass(frozen=True, slots=True)
class Sheet:
    """What an EDS or DCF says of a device.

    Attributes
    ----------
    name : str
        Of the file.
    vendor_name, product_name : str
        "" where the file does not say.
    vendor_id, product_code, revision : int or None
        Of 0x1018, else of the section DeviceInfo; a 0 says nothing.
    entries : mapping of (index, subindex) to ODVariable
    """

    name: str
    vendor_name: str
    product_name: str
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    entries: Mapping[tuple[int, int], ODVariable]

    def type_of(self, index: int, subindex: int = 0) -> DataType | None:
        """Type of an object as profiles name it; None where the sheet has no such object, or one of another kind."""
        entry = self.entries.get((index, subindex))
        return None if entry is None else _NAMES.get(entry.data_type)

    def value_of(self, index: int, subindex: int = 0) -> int | None:
        """Value that a DCF stores for an object, else its default; None where the file gives none."""
        entry = self.entries.get((index, subindex))
        values = () if entry is None else (entry.value, entry.default)
        return next((value for value in values if isinstance(value, int)), None)


def read_sheet(path: Path, node_id: int = 1) -> Sheet:
    """Read an EDS or DCF; what it has by node id, as the drive with this one has it.

    Raises
    ------
    ProfileError
        The file cannot be read, or is none.
    """
    return sheet_of_text(sheet_text(path), path, node_id)


def sheet_text(path: Path) -> str:
    """Text of an EDS or DCF, whose encoding nobody states.

    Raises
    ------
    ProfileError
        The file cannot be read.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError("it is larger than any data sheet")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def sheet_of_text(text: str, path: Path, node_id: int) -> Sheet:
    """Data sheet from its text.

    Raises
    ------
    ProfileError
        It is none.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            dictionary = import_eds(StringIO(text), node_id=node_id)
    except (ValueError, KeyError, TypeError, AttributeError, ConfigParserError) as error:
        raise _unreadable(path, error) from error
    entries: dict[tuple[int, int], ODVariable] = {}
    for index, thing in dictionary.items():
        members = [thing] if isinstance(thing, ODVariable) else thing.values()
        entries |= {(index, member.subindex): member for member in members}
    about = dictionary.device_information
    sheet = Sheet(path.name, about.vendor_name or "", about.product_name or "", None, None, None, entries)
    return replace(
        sheet,
        vendor_id=sheet.value_of(0x1018, 1) or about.vendor_number or None,
        product_code=sheet.value_of(0x1018, 2) or about.product_number or None,
        revision=sheet.value_of(0x1018, 3) or about.revision_number or None,
    )


def _unreadable(path: Path, error: Exception) -> ProfileError:
    reason = " ".join(str(error).replace("'<???>'", path.name).split())
    what = f"data sheet {path} cannot be read: {reason}"
    return ProfileError(what, advice="give an EDS or DCF (CiA 306) as the maker of the drive delivers it")


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
        if counts.per is not None:
            yield counts.per, False


def _rated(rated: Rated | None) -> Iterator[tuple[ObjectReference, bool]]:
    if rated is not None and rated.object is not None:
        yield rated.object, False
