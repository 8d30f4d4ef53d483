"""The checksum of a result file: an edited number is not handed to a controller.

`sha256` is that of the sorted compact JSON (keys in order, no blanks, ASCII) of everything else in the file. `truth` is
left out of it, since a simulator adds it afterwards. It guards against a slip of the hand, not against forgery.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Final

from gateway.errors import InputError

KEY: Final = "sha256"
#: Keys that the checksum does not see.
UNSEALED: Final = (KEY, "truth")


def checksum(plain: Mapping[str, Any]) -> str:
    """Checksum (64 hexadecimal digits) of plain values; those of `UNSEALED` do not count.

    Raises
    ------
    RecursionError
        Nested deeper than any file is.
    """
    body = {key: value for key, value in plain.items() if key not in UNSEALED}
    text = json.dumps(body, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def sealed(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The same values with their checksum, which comes last."""
    return {key: value for key, value in plain.items() if key != KEY} | {KEY: checksum(plain)}


#: What writes a result again.
FROM_DATA: Final = "from the data (servo-gateway estimate DATA --json OUT.json)"


def refuse_edited(plain: Mapping[str, Any], where: str, again: str = FROM_DATA) -> None:
    """Refuse what was changed since it was written; a file of before there were checksums carries none and is taken.

    `again` says from what, or with which command, the file is written again.

    Raises
    ------
    InputError
        The checksum is that of other values.
    """
    if KEY not in plain:
        return
    if plain[KEY] != checksum(plain):
        raise InputError(
            f"{where}: was edited: its {KEY} is that of other values, so nobody has measured what it says; write it"
            f" again {again}"
        )
