"""Read drive profiles, those of the package and an engineer's own files; compare each with the EDS that it names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from drives.datasheet.building import read_sheet
from drives.datasheet.sheet import Sheet
from drives.errors import ProfileError
from drives.objects import OBJECTS
from drives.pdo import OFFSETS
from drives.profile import DriveProfile, ObjectReference
from drives.toml_lines import KeyPath
from drives.validation import Unfit, read_strict

#: Objects that the master uses on every drive, by whether they are mapped to a PDO.
_EVERY: Final = {"controlword": True, "statusword": True, "mode": False, "mode_display": False}


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
    for name, is_mapped in (_EVERY | dict.fromkeys(profile.loss_objects, False)).items():
        entry = OBJECTS[name]
        keys = {"index": entry.index, "subindex": entry.subindex, "type": entry.type}
        yield ObjectReference.model_validate(keys), is_mapped
    yield profile.target_position, True
    yield profile.position.object, True
    for condition in (*profile.safety, *(() if profile.reference is None else (profile.reference,))):
        yield condition.object, False
    for signal in (profile.torque, profile.current):
        if signal is not None:
            yield signal.object, True
    if profile.velocity is not None:
        yield profile.velocity.object, profile.current is not None
    if profile.feedforward is not None:
        yield from ((offset, True) for offset in OFFSETS.values())
    if profile.temperature is not None:
        yield profile.temperature.object, False
    yield from ((each, False) for each in profile.constant_objects)


PROFILE_FOLDER = Path(__file__).parent / "profiles"
#: Profile of a standard-conforming drive of any manufacturer.
GENERIC: Final = "generic-cia402"


def list_profiles() -> list[str]:
    """Return the names of the packaged profiles, sorted."""
    return sorted(path.stem for path in PROFILE_FOLDER.glob("*.toml"))


def load_profile(name_or_path: str | Path) -> DriveProfile:
    """Read one profile.

    Parameters
    ----------
    name_or_path : str or Path
        A name of `list_profiles`, or the path of a TOML file.

    Raises
    ------
    ProfileError
        No such profile, not TOML, an unknown key, a missing constant; every problem of the file at once.
    """
    path = Path(name_or_path)
    packaged = PROFILE_FOLDER / f"{name_or_path}.toml"
    if path.suffix != ".toml" and packaged.is_file():
        path = packaged
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        known = ", ".join(list_profiles())
        advice = f"give the path of a TOML file or one of {known}"
        raise ProfileError(f"drive profile '{name_or_path}' cannot be read: {error}", advice=advice) from error
    return parse_profile(text, str(path), path.parent)


def find_profile(name: str, folder: Path) -> DriveProfile:
    """Read the profile that a cell names: a packaged one, else a file in a folder, with or without `.toml`.

    Raises
    ------
    ProfileError
        As `load_profile`.
    """
    if name in list_profiles():
        return load_profile(name)
    path = (folder / name).resolve()
    with_suffix = path.with_name(f"{path.name}.toml")
    return load_profile(with_suffix if with_suffix.is_file() else path)


def parse_profile(text: str, where: str, folder: Path = PROFILE_FOLDER) -> DriveProfile:
    """Validate the text of a profile.

    Parameters
    ----------
    text : str
        TOML.
    where : str
        File name for messages.
    folder : Path
        Where the EDS that the profile names is looked for.

    Raises
    ------
    ProfileError
        Every problem of the file at once.
    """
    try:
        profile = read_strict(text, DriveProfile)
    except Unfit as error:
        advice = "see docs/how-to/drive-profiles.md, or `servo-gateway profiles schema`"
        raise ProfileError.of(error.messages(where, _table), advice) from error
    object.__setattr__(profile, "_text", text)
    object.__setattr__(profile, "_folder", folder)
    if profile.eds_path is not None:
        check_eds(profile, profile.eds_path)
    return profile


def _table(path: KeyPath) -> str:
    """Return the table header of a path, e.g. `[torque.rated]`; empty at the top of the file."""
    return f"[{'.'.join(map(str, path[:-1]))}]" if len(path) > 1 else ""


def profile_schema() -> dict[str, Any]:
    """Return the JSON schema of profile files for editors."""
    schema = DriveProfile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "servo-gateway drive profile"}
