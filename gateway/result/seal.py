"""Checksum of a result file, so that an edited number is not exported to a controller.

`sha256` is that of the sorted compact JSON (keys in order, no blanks, ASCII) of all other values in the file. `truth`
is excluded, since a simulator adds it afterwards. The checksum detects accidental edits, not forgery.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from drives import files
from gateway.errors import InputError

KEY: Final = files.SEAL
#: Keys that the checksum leaves out.
UNSEALED: Final = (KEY, "truth")


def checksum(plain: Mapping[str, Any]) -> str:
    """Return the checksum (64 hexadecimal digits) of plain values, without the keys in `UNSEALED`.

    Raises
    ------
    RecursionError
        Nested deeper than any file is.
    """
    return files.checksum({key: value for key, value in plain.items() if key not in UNSEALED})


def sealed(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values with their checksum as last key."""
    return {key: value for key, value in plain.items() if key != KEY} | {KEY: checksum(plain)}


#: What writes a result again.
FROM_DATA: Final = "from the data (servo-gateway estimate DATA --json OUT.json)"


def refuse_edited(plain: Mapping[str, Any], where: str, again: str = FROM_DATA) -> None:
    """Raise an error if a file was edited since it was written; an older file without checksum is accepted.

    `again` is the source, or the command, that writes the file again.

    Raises
    ------
    InputError
        The checksum differs from that of the values.
    """
    if KEY not in plain:
        return
    if plain[KEY] != checksum(plain):
        raise InputError(
            f"{where}: was edited: its {KEY} differs from that of its values. Use the original, or write it"
            f" again {again}"
        )
