"""Columns of the store: one row is one check of one robot at one time. Units are in the names; times are UTC."""

from __future__ import annotations

from typing import Any, Final

from gateway.fleet.libraries import library
from gateway.result.fleet import QUANTITIES

#: Version of the columns; in the metadata of every file.
SCHEMA: Final = 1
SCHEMA_KEY: Final = b"servo_gateway_fleet_schema"
TEMPERATURE: Final = "temperature_c"
#: How a row came into the store: a recording alone, a result of it, one re-estimated here, a row of a table.
RECORDING, RESULT, ESTIMATE, SUMMARY = "recording", "result", "estimate", "summary"
#: Columns that identify a row: the same file gives the same rows.
IDENTITY: Final = ("sha256", "line", "kind", "software")


def axis_columns() -> tuple[str, ...]:
    """Return the columns that contain one number per axis."""
    return (*(name for each in QUANTITIES for name in (each.key, each.std_key)), TEMPERATURE)


def columns() -> Any:
    """Return the Arrow schema of a file, with its version."""
    pa = library("pyarrow")
    floats = pa.list_(pa.float64())
    load = pa.struct(
        [
            ("program", pa.string()),
            ("mass_kg", pa.float64()),
            ("mass_std_kg", pa.float64()),
            ("com_m", floats),
            ("com_std_m", floats),
            ("outcome", pa.string()),
        ]
    )
    reported = [
        ("time_utc", pa.timestamp("us")),
        ("duration_s", pa.float64()),
        ("cell", pa.string()),
        ("arm", pa.string()),
        ("serial_numbers", pa.list_(pa.int64())),
        ("kind", pa.string()),
        ("source", pa.string()),
        ("sha256", pa.string()),
        ("line", pa.int64()),
        ("recordings", pa.list_(pa.string())),
        ("software", pa.string()),
        # why the time is implausible; null = plausible
        ("clock", pa.string()),
        *((name, floats) for name in axis_columns()),
        ("loads", pa.list_(load)),
        ("failing", pa.list_(pa.string())),
    ]
    return pa.schema(reported, metadata={SCHEMA_KEY: str(SCHEMA).encode()})
