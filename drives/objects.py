"""Object table: name -> index, subindex, type, unit (CiA 301 and CiA 402-2/-3).

Numbers only: no scaling and no state logic lives here, so that a device written from the standard may share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

DataType = Literal["u8", "i8", "u16", "i16", "u32", "i32"]

#: struct format character of every basic type, little endian on the wire (CiA 301, 7.1.4). Those of 64 bits are
#: configuration alone: no profile names one.
STRUCT_CODE: Final[dict[str, str]] = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "i64": "q",
}
SIZE_BYTES: Final[dict[str, int]] = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4, "u64": 8, "i64": 8}


def decode_integer(data: bytes, size_bytes: int, *, signed: bool) -> int:
    """Decode the integer of an SDO response, truncated to the size of the object.

    Drives answer objects of 8 and 16 bits with 4 bytes, filled up with the sign or, also for negative values, with 0.

    Raises
    ------
    ValueError
        There are fewer bytes, or the bytes that are cut off belong to a value that the object cannot hold.
    """
    value = int.from_bytes(data[:size_bytes], "little", signed=signed)
    fills = (b"\0", b"\xff") if value < 0 else (b"\0",)
    if len(data) < size_bytes or all(data[size_bytes:].strip(fill) for fill in fills):
        kind = f"{'i' if signed else 'u'}{8 * size_bytes}"
        raise ValueError(f"{len(data)} bytes ({data[:8].hex(' ')}) are no {kind}")
    return value


@dataclass(frozen=True, slots=True)
class ObjectEntry:
    """One entry of a device's object dictionary.

    Attributes
    ----------
    name : str
        Name used in messages.
    index, subindex : int
        Its address.
    type : str
        One of u8 i8 u16 i16 u32 i32, or `str` for a visible string.
    unit : str
        What one least significant bit means; "" for bit fields and plain numbers.
    """

    name: str
    index: int
    subindex: int
    type: str
    unit: str = ""

    @property
    def address(self) -> tuple[int, int]:
        """(index, subindex)."""
        return self.index, self.subindex

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.subindex:02X} ({self.name})"


_TABLE: Final[tuple[ObjectEntry, ...]] = (
    # CiA 301
    ObjectEntry("device_type", 0x1000, 0, "u32"),
    ObjectEntry("error_register", 0x1001, 0, "u8"),
    ObjectEntry("error_history_count", 0x1003, 0, "u8"),
    ObjectEntry("error_history_1", 0x1003, 1, "u32"),
    ObjectEntry("sync_cob_id", 0x1005, 0, "u32"),
    ObjectEntry("communication_cycle_period", 0x1006, 0, "u32", "us"),
    ObjectEntry("device_name", 0x1008, 0, "str"),
    ObjectEntry("hardware_version", 0x1009, 0, "str"),
    ObjectEntry("software_version", 0x100A, 0, "str"),
    ObjectEntry("store_parameters", 0x1010, 1, "u32"),
    ObjectEntry("restore_parameters", 0x1011, 1, "u32"),
    ObjectEntry("guard_time", 0x100C, 0, "u16", "ms"),
    ObjectEntry("life_time_factor", 0x100D, 0, "u8"),
    ObjectEntry("emcy_cob_id", 0x1014, 0, "u32"),
    ObjectEntry("consumer_heartbeat_count", 0x1016, 0, "u8"),
    ObjectEntry("consumer_heartbeat", 0x1016, 1, "u32", "node id << 16 | ms"),
    ObjectEntry("producer_heartbeat", 0x1017, 0, "u16", "ms"),
    ObjectEntry("vendor_id", 0x1018, 1, "u32"),
    ObjectEntry("product_code", 0x1018, 2, "u32"),
    ObjectEntry("revision", 0x1018, 3, "u32"),
    ObjectEntry("serial_number", 0x1018, 4, "u32"),
    ObjectEntry("sync_counter_overflow", 0x1019, 0, "u8"),
    ObjectEntry("error_behaviour", 0x1029, 1, "u8"),
    # manufacturer: identification of a simulator
    ObjectEntry("simulator_name", 0x5FFE, 0, "str"),
    # CiA 402
    ObjectEntry("abort_connection_option", 0x6007, 0, "i16"),
    ObjectEntry("error_code", 0x603F, 0, "u16"),
    ObjectEntry("controlword", 0x6040, 0, "u16"),
    ObjectEntry("statusword", 0x6041, 0, "u16"),
    ObjectEntry("quick_stop_option", 0x605A, 0, "i16"),
    ObjectEntry("shutdown_option", 0x605B, 0, "i16"),
    ObjectEntry("disable_operation_option", 0x605C, 0, "i16"),
    ObjectEntry("halt_option", 0x605D, 0, "i16"),
    ObjectEntry("fault_reaction_option", 0x605E, 0, "i16"),
    ObjectEntry("mode", 0x6060, 0, "i8"),
    ObjectEntry("mode_display", 0x6061, 0, "i8"),
    ObjectEntry("position_demand", 0x6062, 0, "i32", "count"),
    ObjectEntry("position_internal", 0x6063, 0, "i32", "count"),
    ObjectEntry("position", 0x6064, 0, "i32", "count"),
    ObjectEntry("following_error_window", 0x6065, 0, "u32", "count"),
    ObjectEntry("following_error_timeout", 0x6066, 0, "u16", "ms"),
    ObjectEntry("velocity_demand", 0x606B, 0, "i32", "profile"),
    ObjectEntry("velocity", 0x606C, 0, "i32", "profile"),
    ObjectEntry("target_torque", 0x6071, 0, "i16", "per mille of rated torque"),
    ObjectEntry("max_torque", 0x6072, 0, "u16", "per mille of rated torque"),
    ObjectEntry("max_current", 0x6073, 0, "u16", "per mille of rated current"),
    ObjectEntry("torque_demand", 0x6074, 0, "i16", "per mille of rated torque"),
    ObjectEntry("rated_current", 0x6075, 0, "u32", "mA"),
    ObjectEntry("rated_torque", 0x6076, 0, "u32", "mNm"),
    ObjectEntry("torque", 0x6077, 0, "i16", "per mille of rated torque"),
    ObjectEntry("current", 0x6078, 0, "i16", "per mille of rated current"),
    ObjectEntry("dc_link_voltage", 0x6079, 0, "u32", "mV"),
    ObjectEntry("target_position", 0x607A, 0, "i32", "count"),
    ObjectEntry("position_range_min", 0x607B, 1, "i32", "count"),
    ObjectEntry("position_range_max", 0x607B, 2, "i32", "count"),
    ObjectEntry("home_offset", 0x607C, 0, "i32", "count"),
    ObjectEntry("position_limit_min", 0x607D, 1, "i32", "count"),
    ObjectEntry("position_limit_max", 0x607D, 2, "i32", "count"),
    ObjectEntry("polarity", 0x607E, 0, "u8"),
    ObjectEntry("max_profile_velocity", 0x607F, 0, "u32", "profile"),
    ObjectEntry("max_motor_speed", 0x6080, 0, "u32", "rpm"),
    ObjectEntry("profile_velocity", 0x6081, 0, "u32", "profile"),
    ObjectEntry("profile_acceleration", 0x6083, 0, "u32", "profile"),
    ObjectEntry("profile_deceleration", 0x6084, 0, "u32", "profile"),
    ObjectEntry("quick_stop_deceleration", 0x6085, 0, "u32", "profile"),
    ObjectEntry("encoder_increments", 0x608F, 1, "u32", "count"),
    ObjectEntry("encoder_revolutions", 0x608F, 2, "u32", "revolution"),
    ObjectEntry("gear_motor_revolutions", 0x6091, 1, "u32", "revolution"),
    ObjectEntry("gear_shaft_revolutions", 0x6091, 2, "u32", "revolution"),
    ObjectEntry("feed_constant_feed", 0x6092, 1, "u32", "count"),
    ObjectEntry("feed_constant_revolutions", 0x6092, 2, "u32", "revolution"),
    ObjectEntry("position_offset", 0x60B0, 0, "i32", "count"),
    ObjectEntry("velocity_offset", 0x60B1, 0, "i32", "profile"),
    ObjectEntry("torque_offset", 0x60B2, 0, "i16", "per mille of rated torque"),
    ObjectEntry("interpolation_kind", 0x60C0, 0, "i16"),
    ObjectEntry("interpolation_data", 0x60C1, 1, "i32", "count"),
    ObjectEntry("interpolation_time_value", 0x60C2, 1, "u8", "10^index s"),
    ObjectEntry("interpolation_time_index", 0x60C2, 2, "i8"),
    ObjectEntry("positive_torque_limit", 0x60E0, 0, "u16", "per mille of rated torque"),
    ObjectEntry("negative_torque_limit", 0x60E1, 0, "u16", "per mille of rated torque"),
    ObjectEntry("following_error", 0x60F4, 0, "i32", "count"),
    ObjectEntry("digital_inputs", 0x60FD, 0, "u32"),
    ObjectEntry("target_velocity", 0x60FF, 0, "i32", "profile"),
    ObjectEntry("supported_modes", 0x6502, 0, "u32"),
)

#: Every object by its name.
OBJECTS: Final[dict[str, ObjectEntry]] = {entry.name: entry for entry in _TABLE}
_BY_ADDRESS: Final[dict[tuple[int, int], ObjectEntry]] = {entry.address: entry for entry in _TABLE}

#: First index of the four PDO parameter areas (CiA 301, 7.5.2).
RPDO_COMMUNICATION: Final = 0x1400
RPDO_MAPPING: Final = 0x1600
TPDO_COMMUNICATION: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00

_PDO_AREAS: Final = {
    0x14: "RPDO{} parameter",
    0x15: "RPDO{} parameter",
    0x16: "RPDO{} mapping",
    0x18: "TPDO{} parameter",
    0x1A: "TPDO{} mapping",
}


def object_name(index: int, subindex: int = 0) -> str:
    """Name of an object for messages, e.g. ``6077:00 (torque)``; a PDO area is named by its number."""
    entry = _BY_ADDRESS.get((index, subindex))
    if entry is not None:
        return str(entry)
    area = _PDO_AREAS.get(index >> 8)
    if area is not None:
        return f"{index:04X}:{subindex:02X} ({area.format((index & 0xFF) + 1)})"
    return f"{index:04X}:{subindex:02X}"
