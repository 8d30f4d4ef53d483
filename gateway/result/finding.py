"""A finding: what a check of drives, of data or of this computer reports. Nothing numerical is loaded for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from gateway.result.names import SILENT

#: `ok` is of the checks of drives and computers alone; a result has the other three.
Severity = Literal["ok", "info", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """A fact to report about one place, such as `J2 node 2:6077:00 (torque)`.

    `advice` says what to do and is empty where nothing is to be done. `check` is the name of the test that reports it,
    for programs: it stays when the text changes.
    """

    severity: Severity
    where: str
    what: str
    advice: str = ""
    check: str = field(default="", metadata=SILENT)
