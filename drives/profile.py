"""Drive profiles: data of one drive model that the master needs (`profiles/*.toml`).

Every constant carries its source. A constant that is missing is an error: nothing is ever taken as 1.0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, PrivateAttr, model_validator

from drives.objects import RPDO_COMMUNICATION, RPDO_MAPPING, TPDO_COMMUNICATION, TPDO_MAPPING
from drives.profile_parts import (
    NEEDED_WRITES,
    Constant,
    CountsFromObjects,
    EmcyEntry,
    ExpectedIdentity,
    Feedforward,
    Heartbeat,
    ObjectReference,
    Position,
    Rated,
    Reference,
    SafetyCondition,
    SdoTimes,
    Signal,
    Source,
    StateMachine,
    Temperature,
    TorqueOffsetWord,
    Velocity,
    Write,
    is_assumed,
)
from drives.validation import Strict

__all__ = [
    "Constant",
    "CountsFromObjects",
    "DriveProfile",
    "ObjectReference",
    "Rated",
    "Signal",
    "TorqueOffsetWord",
]

#: And beside them in a run with feedforward.
_FEEDFORWARD_WRITES = (RPDO_COMMUNICATION + 1, RPDO_MAPPING + 1, 0x60B1)


class DriveProfile(Strict):
    """Data of one drive model that the master needs."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = Field(
        description="as cells name it; the file's name"
    )
    description: str = Field(description="make, series, firmware")
    source: Source
    eds: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*\.eds$")] | None = Field(
        default=None, description="data sheet in the same folder; every object that is used is looked up in it"
    )
    no_motion: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        default=(), description="why drives of this model are read and not moved, such as an object that they lack"
    )
    identity: ExpectedIdentity = Field(default=ExpectedIdentity(), description="expected content of 0x1018")
    torque: Signal = Field(description="the measured torque, or the current that it follows from")
    current: Signal | None = Field(default=None, description="actual current beside it, in a second TPDO")
    torque_offset: TorqueOffsetWord | None = Field(
        default=None, description="absent: 0x60B2 is scaled as the torque is"
    )
    velocity: Velocity | None = Field(default=None, description="actual speed, in a second TPDO")
    feedforward: Feedforward | None = Field(
        default=None, description="absent: the drive has no 0x60B1, or it is not known how it takes it"
    )
    temperature: Temperature | None = Field(default=None, description="absent: no temperature is recorded")
    position: Position = Field(description="actual position and its counts")
    state_machine: StateMachine = Field(description="times and behaviour of the CiA 402 state machine")
    sdo: SdoTimes = Field(description="how long an answer may take")
    heartbeat: Heartbeat = Field(description="heartbeat monitoring in both directions, and its times")
    write: Write = Field(description="every object that the master may write")
    emcy: tuple[EmcyEntry, ...] = Field(default=(), description="meaning of emergency codes")
    safety: tuple[SafetyCondition, ...] = Field(
        default=(), description="conditions of the safety chain that must hold before the drive is enabled"
    )
    reference: Reference | None = Field(
        default=None, description="absent: the drive does not report whether its encoder is referenced"
    )
    _text: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=Path())

    @property
    def text(self) -> str:
        """Return the TOML text of the profile, which is stored in recordings."""
        return self._text

    @property
    def eds_path(self) -> Path | None:
        """Path of the electronic data sheet, if the profile names one."""
        return None if self.eds is None else self._folder / self.eds

    @property
    def needs_torque_constant(self) -> bool:
        """Whether the measured torque is a current times the torque constant of the cell file."""
        return self.torque.is_current

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Return why a drive of this profile may be read but not moved, each with a remedy; empty = may be moved."""
        found = list(self.no_motion)
        if self.torque.assumed:
            where = f"0x{self.torque.object.index:04X}:{self.torque.object.subindex:02X}"
            found.append(
                f"what one bit of the torque ({where}) is, is assumed: find it out on the drive or in its manual, "
                "then write it to [torque] with source and basis"
            )
        counts = self.position.counts_per_revolution
        if isinstance(counts, Constant) and is_assumed(counts.source):
            found.append(
                f"{counts.value:g} counts per motor revolution are assumed: write what is mounted to [position] "
                "with its source"
            )
        if self.heartbeat.abort_connection == 2:
            found.append(
                "abort_connection = 2 (disable voltage) lets a moving axis coast, until its brake has closed, when the "
                "master is lost: set 3 (quick stop) if the drive takes it"
            )
        return tuple(found)

    def emcy_entry(self, code: int) -> EmcyEntry | None:
        """Return the entry of an EMCY code, or None if the profile does not list it."""
        return next((entry for entry in self.emcy if entry.code == code), None)

    @model_validator(mode="after")
    def _consistent(self) -> DriveProfile:
        missing = [f"0x{index:04X}" for index in NEEDED_WRITES if index not in self.write.allow]
        if missing and not self.no_motion:
            raise ValueError(f"write.allow lacks {', '.join(missing)}, which bringing the drive up needs")
        if self.current is not None and not self.current.is_current:
            raise ValueError("current: kind permille_rated_torque is not a current")
        if self.heartbeat.producer_ms is not None and 0x1017 not in self.write.allow:
            raise ValueError("heartbeat.producer_ms needs 0x1017 in write.allow")
        second = TPDO_COMMUNICATION + 1 in self.write.allow and TPDO_MAPPING + 1 in self.write.allow
        if (self.current is not None or self.torque.object.size_bits > 16) and not (second or self.no_motion):
            raise ValueError("a second TPDO is needed: write.allow lacks 0x1801 and 0x1A01")
        if self.feedforward is not None:
            self._check_feedforward()
        return self

    def _check_feedforward(self) -> None:
        if self.velocity is None:
            raise ValueError("feedforward needs [velocity]: the velocity offset 0x60B1 is in its unit")
        if self.torque_offset is None and not self.torque.kind.startswith("permille"):
            raise ValueError("feedforward needs [torque_offset]: it is not known what one bit of 0x60B2 is")
        missing = [f"0x{index:04X}" for index in _FEEDFORWARD_WRITES if index not in self.write.allow]
        if missing:
            raise ValueError(f"feedforward needs a second RPDO: write.allow lacks {', '.join(missing)}")
