"""Finding of a check of drives, data or this computer. No numerical library is imported."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from gateway.result.names import SILENT

#: `ok` is of the checks of drives and computers alone; a result has the other three.
Severity = Literal["ok", "info", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Reported fact about one place, such as `J2 node 2:6077:00 (torque)`.

    `advice` states what to do and is empty if no action is required. `check` is the stable name of the check, for
    programs.
    """

    severity: Severity
    where: str
    what: str
    advice: str = ""
    check: str = field(default="", metadata=SILENT)
