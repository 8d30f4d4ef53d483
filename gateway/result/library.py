"""Loads of a robot: the file `<cell stem>.loads.json` beside the cell file, one entry for each label.

An entry states the load and its origin for a reader, and names the result file with its SHA-256. Commands read that
file, since they need more than the load: the unloaded arm, effects, noise floor. JSON, since results are JSON and are
sealed in the same way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from drives.files import read_sealed
from gateway.errors import InputError
from gateway.result.origin import file_sha256

SUFFIX: Final = ".loads.json"


def library_of(cell: Path) -> Path:
    """Return the library beside a cell file."""
    return cell.with_suffix(SUFFIX)


def read_library(path: Path) -> dict[str, dict[str, Any]]:
    """Return the entries of a library by label.

    Raises
    ------
    InputError
        It is none, cannot be read, or was edited.
    """
    try:
        if not path.name.endswith(SUFFIX):
            raise ValueError(f"its name does not end with {SUFFIX}")
        return read_sealed(path)["loads"]
    except (OSError, ValueError, KeyError) as error:
        advice = "restore it, or save the loads again into a new one (estimate --cell CELL --save)"
        raise InputError(f"{path}: no library of loads: {error}; {advice}") from error


def result_file(path: Path) -> tuple[Path, str | None]:
    """Return the result file that is meant, and the only load of it that counts; None = all its loads.

    `CELL.loads.json#LABEL` is the result of that load, and `CELL.loads.json` that of the only load of a library.

    Raises
    ------
    InputError
        A library that holds no such load or several, or whose result was moved or edited.
    """
    file, mark, label = str(path).partition(f"{SUFFIX}#")
    if not (mark or file.endswith(SUFFIX)):
        return path, None
    library = Path(file + SUFFIX if mark else file)
    entries = read_library(library)
    label = label if mark else next(iter(entries), "")
    if label not in entries or (len(entries) > 1 and not mark):
        raise InputError(f"{path}: name one load of the library as {library.name}#LABEL; it holds {', '.join(entries)}")
    origin = library.parent / entries[label]["result"]
    if not origin.is_file() or file_sha256(origin) != entries[label]["result_sha256"]:
        wrong = "has another sha256 than when it was saved" if origin.is_file() else "is not there"
        advice = "restore that file, or estimate the load again with --save"
        raise InputError(f"{library}: load '{label}' is of {origin}, which {wrong}; {advice}")
    return origin, label
