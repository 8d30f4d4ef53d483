"""What the motion loop and the process that writes the recording say to each other."""

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
    """First message to the writer: the file; fields as of `RecordingWriter`."""

    path: Path
    header: RecordingHeader
    arm: ArmHeader
    earlier: Recording | None
    write: Write


@dataclass(frozen=True, slots=True, eq=False)
class Keep:
    """To the writer: a visit or a period that has its number."""

    arm: str
    visit: Visit | Period


@dataclass(frozen=True, slots=True)
class Finish:
    """To the writer: how the run ended; fields as of `RecordingWriter.finish`, and the number of the question."""

    question: int
    arm: str
    status: str
    reason: str
    statistics: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Ready:
    """From the writer, once: it has begun, or why it cannot (empty = it can)."""

    refused: str


@dataclass(frozen=True, slots=True)
class Written:
    """From the writer: all visits up to this number are on disk."""

    number: int


@dataclass(frozen=True, slots=True)
class Failed:
    """From the writer: a write has failed; the visit is still held and goes into the next one."""

    reason: str


@dataclass(frozen=True, slots=True)
class Finished:
    """From the writer: answer to that `Finish`; why it could not be written (empty = it is on disk)."""

    question: int
    failed: str
