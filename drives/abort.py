"""SDO abort codes: meaning and probable cause (CiA 301, table 22)."""

from __future__ import annotations

from typing import Final

from drives.errors import SdoAbort

TOGGLE_NOT_ALTERNATED: Final = 0x05030000
TIMED_OUT: Final = 0x05040000
COMMAND_UNKNOWN: Final = 0x05040001
READ_ONLY: Final = 0x06010002
NO_OBJECT: Final = 0x06020000
NO_SUBINDEX: Final = 0x06090011
NO_DATA: Final = 0x08000024

#: Abort codes for a missing object. An object that exists but must not be read this way (0x06010000, 0x06010001) is not
#: absent: there the profile is wrong.
ABSENT: Final = frozenset({NO_OBJECT, NO_SUBINDEX, NO_DATA})

#: Abort code -> (meaning, probable cause); CiA 301, table 22.
ABORT_CODES: Final[dict[int, tuple[str, str]]] = {
    TOGGLE_NOT_ALTERNATED: ("toggle bit not alternated", "a frame was lost or doubled; try again"),
    TIMED_OUT: ("SDO protocol timed out", "the drive is busy or the bus overloaded; try again"),
    COMMAND_UNKNOWN: ("command specifier not valid or unknown", "the drive does not support this kind of transfer"),
    0x05040002: ("invalid block size", "the drive does not support this kind of transfer"),
    0x05040003: ("invalid sequence number", "a frame was lost; try again"),
    0x05040004: ("CRC error", "a frame was corrupted; try again"),
    0x05040005: ("out of memory", "restart the drive"),
    0x06010000: ("unsupported access to an object", "correct the profile: this object cannot be used this way"),
    0x06010001: ("attempt to read a write-only object", "correct the profile"),
    READ_ONLY: ("attempt to write a read-only object", "the value is fixed in this drive; correct the profile"),
    NO_OBJECT: ("object does not exist", "wrong profile or firmware: compare with the drive's object dictionary"),
    0x06040041: ("object cannot be mapped to a PDO", "correct the profile: choose an object that can be mapped"),
    0x06040042: ("number and length of the objects exceed the PDO", "correct the profile: at most eight bytes a PDO"),
    0x06040043: ("general parameter incompatibility", "the values already in the drive contradict this one"),
    0x06040047: ("general internal incompatibility", "restart the drive"),
    0x06060000: ("hardware error", "read the drive's error history 0x1003 and its display"),
    0x06070010: ("data type or length does not match", "correct the type of the object in the profile"),
    0x06070012: ("data too long", "correct the type of the object in the profile"),
    0x06070013: ("data too short", "correct the type of the object in the profile"),
    NO_SUBINDEX: ("subindex does not exist", "wrong profile or firmware: compare with the drive's object dictionary"),
    0x06090030: ("invalid value", "the drive does not accept this value; see its manual"),
    0x06090031: ("value too high", "the drive does not accept this value; see its manual"),
    0x06090032: ("value too low", "the drive does not accept this value; see its manual"),
    0x06090036: ("maximum below minimum", "the limits already in the drive contradict this one"),
    0x060A0023: ("resource not available", "another SDO client holds the channel, or the object has no value"),
    0x08000000: ("general error", "read the drive's error history 0x1003"),
    0x08000020: ("data cannot be stored", "read the drive's error history 0x1003"),
    0x08000021: ("local control", "release the local control: another tool or panel holds the drive"),
    0x08000022: ("present device state", "the drive refuses this in its NMT or CiA 402 state: disable it first"),
    0x08000023: ("no object dictionary present", "restart the drive"),
    NO_DATA: ("no data available", "the value does not exist yet"),
}


def abort_error(node_id: int, address: tuple[int, int], code: int) -> SdoAbort:
    """Return the error for an SDO abort, with the meaning of its code and the probable cause."""
    what, advice = ABORT_CODES.get(code, ("code unknown to CiA 301", "see the drive's manual"))
    return SdoAbort(
        f"SDO abort 0x{code:08X}, {what}", node=node_id, index=address[0], subindex=address[1], code=code, advice=advice
    )
