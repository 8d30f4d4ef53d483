"""Columns of the store, identity of a robot (cell, arm, serial numbers of the drives), and the optional libraries.

One row is one check of one robot at one time. Units are in the names; times are UTC.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from gateway.data.extras import needed
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


def library(name: str) -> Any:
    """Import a module of the extra `fleet`; raise `ConfigError` if it is not installed."""
    return needed(name, "a fleet", "fleet")


#: Letters of a name that stay in the name of a folder.
_LONGEST = 40
_CODE = 8


@dataclass(frozen=True, slots=True)
class RobotName:
    """Identity of a robot, including drive serial numbers: with another drive its constants may differ."""

    cell: str
    arm: str
    serial_numbers: tuple[int | None, ...] = ()

    @property
    def key(self) -> str:
        """Readable and unique name for folders and pages."""
        reported = json.dumps([self.cell, self.arm, list(self.serial_numbers)])
        code = hashlib.sha256(reported.encode()).hexdigest()[:_CODE]
        return f"{_plain(self.cell)}-{_plain(self.arm)}-{code}"


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]+", "_", text)[:_LONGEST] or "_"


def robot_name(cell: str, arm: str, serial_numbers: Sequence[int | None]) -> RobotName:
    """Return the identity of a robot; drives without serial number (0 counts as none) are not distinguished."""
    reported = tuple(number or None for number in serial_numbers)
    return RobotName(cell, arm, reported if any(reported) else ())


def moment(text: str) -> datetime:
    """Return a time of a file in UTC; a time without zone is UTC.

    Raises
    ------
    ValueError
        The text is not a time.
    """
    plain = text.strip().removesuffix(" UTC")
    at = datetime.fromisoformat(plain)
    return at.replace(tzinfo=UTC) if at.tzinfo is None else at.astimezone(UTC)
