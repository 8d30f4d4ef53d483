"""Numbers of a data sheet (CiA 306, 4.3): decimal, hexadecimal, and relative to the node id by `$NODEID`."""

from __future__ import annotations

import re
from typing import Final

_NUMBER: Final = re.compile(r"([+-]?)(?:0x([0-9a-f]+)|([0-9][0-9a-f]*)h|([0-9]+))", re.IGNORECASE)
_BY_NODE: Final = re.compile(r"(?:(.*)\+)?\$NODEID(?:\+(.*))?", re.IGNORECASE)
_OCTAL: Final = re.compile(r"[+-]?0+[1-7][0-7]+")
#: Longest text of a number of 64 bits, with room for zeros in front.
_LONGEST: Final = 64


def number(text: str) -> tuple[int, bool]:
    """Number of a text, and whether the node id is to be added to it.

    Zeros in front of a decimal number mean nothing (`001`, `05`).

    Raises
    ------
    ValueError
        The text is not a number.
    """
    plain = "".join(text.partition(";")[0].split())
    by_node = _BY_NODE.fullmatch(plain)
    if by_node is not None:
        before, after = by_node.groups()
        if before and after:
            raise ValueError(f"'{text}' is not a number")
        return _plain(before or after or "0"), True
    return _plain(plain), False


def resolved(text: str, node_id: int) -> int:
    """Number of a text for one node.

    Raises
    ------
    ValueError
        The text is not a number.
    """
    value, by_node = number(text)
    return value + node_id if by_node else value


def plain_number(text: str) -> int:
    """Number of a text that does not depend on the node id.

    Raises
    ------
    ValueError
        It does, or is not a number.
    """
    value, by_node = number(text)
    if by_node:
        raise ValueError(f"'{text}' depends on the node id")
    return value


def is_by_node(text: str) -> bool:
    """Whether a text depends on the node id."""
    return "$NODEID" in text.upper()


def is_ambiguous(text: str) -> bool:
    """Whether a text is another number where a leading zero means octal; it is read as decimal."""
    return _OCTAL.fullmatch(text.strip()) is not None


def _plain(text: str) -> int:
    found = _NUMBER.fullmatch(text) if len(text) <= _LONGEST else None
    if found is None:
        raise ValueError(f"'{text}' is not a number")
    sign, hexadecimal, with_h, decimal = found.groups()
    value = int(decimal) if decimal else int(hexadecimal or with_h, 16)
    return -value if sign == "-" else value
