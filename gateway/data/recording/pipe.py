"""Messages between the motion loop and the process that writes the recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.data.period import Period
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import ArmHeader, RecordingHeader, Write
from gateway.data.visit import Visit

PROGRAM = "gateway.data.recording.writer_process"


@dataclass(frozen=True, slots=True)
class Start:
    """First message to the writer: the file; fields as in `RecordingWriter`."""

    path: Path
    header: RecordingHeader
    arm: ArmHeader
    earlier: Recording | None
    write: Write


@dataclass(frozen=True, slots=True, eq=False)
class Keep:
    """Message to the writer: a numbered visit or period."""

    arm: str
    visit: Visit | Period


@dataclass(frozen=True, slots=True)
class Finish:
    """Message to the writer: result of the run; fields of `RecordingWriter.finish`, and the number of the request."""

    question: int
    arm: str
    status: str
    reason: str
    statistics: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Ready:
    """First answer of the writer: it is ready, or the error (empty if ready)."""

    refused: str


@dataclass(frozen=True, slots=True)
class Written:
    """Message from the writer: all visits up to this number are on disk."""

    number: int


@dataclass(frozen=True, slots=True)
class Failed:
    """Message from the writer: a write failed; the visit is kept in memory and included in the next write."""

    reason: str


@dataclass(frozen=True, slots=True)
class Finished:
    """Answer to a `Finish`: the write error, empty if the file is on disk."""

    question: int
    failed: str
