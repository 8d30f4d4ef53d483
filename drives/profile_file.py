"""Read drive profiles: those of the package, and an engineer's own files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from drives.errors import ProfileError
from drives.profile import DriveProfile
from drives.profile_check import check_eds
from drives.toml_lines import KeyPath
from drives.validation import Unfit, read_strict

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
