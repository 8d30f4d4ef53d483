"""Identity of the robot of a check: cell, arm and serial numbers of the drives; and its time in UTC."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

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
