"""Values of objects by CiA 301 data type: bytes on the wire, text in a configuration file, number in the ledger.

Numbers of a data sheet (CiA 306, 4.3) are decimal, hexadecimal, or relative to the node id by `$NODEID`.
"""

from __future__ import annotations

import re
import struct
from typing import Final

from canopen.objectdictionary import datatypes

from drives.objects import decode_integer

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


Value = int | float | str | bytes

#: Bits of every integer type of CiA 301, table 44; below zero = signed.
_INTEGERS: Final[dict[int, int]] = {
    datatypes.BOOLEAN: 8,
    datatypes.UNSIGNED8: 8,
    datatypes.UNSIGNED16: 16,
    datatypes.UNSIGNED24: 24,
    datatypes.UNSIGNED32: 32,
    datatypes.UNSIGNED40: 40,
    datatypes.UNSIGNED48: 48,
    datatypes.UNSIGNED56: 56,
    datatypes.UNSIGNED64: 64,
    datatypes.INTEGER8: -8,
    datatypes.INTEGER16: -16,
    datatypes.INTEGER24: -24,
    datatypes.INTEGER32: -32,
    datatypes.INTEGER40: -40,
    datatypes.INTEGER48: -48,
    datatypes.INTEGER56: -56,
    datatypes.INTEGER64: -64,
}
_FLOATS: Final = {datatypes.REAL32: ("<f", "u32"), datatypes.REAL64: ("<d", "u64")}
_TEXTS: Final = {datatypes.VISIBLE_STRING: "latin-1", datatypes.UNICODE_STRING: "utf-16-le"}
#: Widths that the write ledger can hold.
_LEDGER_BITS: Final = frozenset({8, 16, 32, 64})


def is_held(data_type: int) -> bool:
    """Whether objects of a type are read and stored; a domain, or a type of the maker, is not."""
    return data_type in _INTEGERS or data_type in _FLOATS or data_type in _TEXTS or data_type == datatypes.OCTET_STRING


def type_name(data_type: int) -> str:
    """A type as people name it: `u16`, `f32`, `text`, `bytes`, else its number."""
    if data_type in _INTEGERS:
        bits = _INTEGERS[data_type]
        return f"{'i' if bits < 0 else 'u'}{abs(bits)}"
    if data_type in _FLOATS:
        return "f32" if data_type == datatypes.REAL32 else "f64"
    return "text" if data_type in _TEXTS else "bytes" if data_type == datatypes.OCTET_STRING else f"0x{data_type:04X}"


def size_bytes(data_type: int) -> int | None:
    """Size of the objects of an integer type; None = any other type."""
    return abs(_INTEGERS[data_type]) // 8 if data_type in _INTEGERS else None


def decoded(data_type: int, data: bytes) -> Value:
    """Value of what an upload gave.

    Raises
    ------
    ValueError
        The length does not fit the type.
    """
    if data_type in _INTEGERS:
        bits = _INTEGERS[data_type]
        return decode_integer(data, abs(bits) // 8, signed=bits < 0)
    if data_type in _FLOATS:
        layout = struct.Struct(_FLOATS[data_type][0])
        if len(data) != layout.size:
            raise ValueError(f"{len(data)} bytes are no {type_name(data_type)}")
        return layout.unpack(data)[0]
    if data_type in _TEXTS:
        return data.decode(_TEXTS[data_type], errors="replace").rstrip("\0")
    return data


def encoded(data_type: int, value: Value) -> bytes:
    """Bytes of a value on the wire; two values are the same where these are.

    Raises
    ------
    ValueError
        The type cannot hold it.
    """
    try:
        if data_type in _INTEGERS and isinstance(value, int):
            bits = _INTEGERS[data_type]
            return value.to_bytes(abs(bits) // 8, "little", signed=bits < 0)
        if data_type in _FLOATS and isinstance(value, int | float):
            return struct.pack(_FLOATS[data_type][0], value)
        if data_type in _TEXTS and isinstance(value, str):
            return value.encode(_TEXTS[data_type])
        if isinstance(value, bytes):
            return value
    except (OverflowError, UnicodeEncodeError) as error:
        raise ValueError(f"{value!r} is no {type_name(data_type)}") from error
    raise ValueError(f"{value!r} is no {type_name(data_type)}")


def written(data_type: int, value: Value) -> str:
    """Text of a value in a device configuration file (CiA 306): decimal where there is a sign, for every reader."""
    if data_type in _INTEGERS and isinstance(value, int):
        bits = _INTEGERS[data_type]
        return str(value) if bits < 0 else f"0x{value:0{bits // 4}X}"
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, str) else repr(value)


def understood(data_type: int, text: str, node_id: int) -> Value:
    """Value of a text in a device configuration file; a negative number may be written as two's complement.

    Raises
    ------
    ValueError
        It is not a value of this type.
    """
    if data_type in _INTEGERS:
        bits = _INTEGERS[data_type]
        value = resolved(text, node_id)
        if bits < 0 and 1 << (-bits - 1) <= value < 1 << -bits:
            value -= 1 << -bits
        encoded(data_type, value)
        return value
    if data_type in _FLOATS:
        return decoded(data_type, encoded(data_type, float(text.replace("_", "?"))))
    return text if data_type in _TEXTS else bytes.fromhex(text)


def ledger_value(data_type: int, value: Value) -> tuple[str, int] | None:
    """Type and number as which a value is written and entered in the ledger; None where it holds no such type."""
    if data_type in _FLOATS:
        return _FLOATS[data_type][1], int.from_bytes(encoded(data_type, value), "little")
    if data_type in _INTEGERS and abs(_INTEGERS[data_type]) in _LEDGER_BITS and isinstance(value, int):
        return type_name(data_type), value
    return None
