"""Answers of an engineer about values that the data sheet of a drive does not state, one key each."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from drives.profile import CyclicMode, Positive, is_assumed
from drives.validation import Strict

Text = Annotated[str, Field(min_length=1)]
ObjectText = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}(:[0-9A-Fa-f]{2})?$")]
TypedMode = Annotated[CyclicMode, BeforeValidator(lambda typed: {"7": 7, "8": 8}.get(str(typed), typed))]

ADVICE = "docs/reference/profile-answers.md lists questions and answers"


class ProfileAnswers(Strict):
    """Answers to the questions of a profile draft; whatever is left out stays open."""

    torque_object: ObjectText | None = Field(
        default=None, description="object of the measured torque or current, such as 0x6077 or 0x30D1:02"
    )
    torque_kind: Literal["permille_rated_torque", "permille_rated_current", "milliampere", "internal_unit"] | None = (
        Field(default=None, description="what one bit of it is")
    )
    torque_nature: Literal["measured", "demand"] | None = Field(
        default=None, description="whether it is measured or demanded"
    )
    rated_object: ObjectText | None = Field(
        default=None, description="object of the rated torque or current, where it is not 0x6076 or 0x6075"
    )
    rated_unit: Positive | None = Field(
        default=None, description="Nm per bit of 0x6076, or A per bit of 0x6075: 0.001 by the standard"
    )
    rated_value: Positive | None = Field(
        default=None, description="Nm or A that 1000 per mille stand for, where the drive does not show it"
    )
    internal_unit_a: Positive | None = Field(default=None, description="A per bit, kind internal_unit")
    current_reference: Literal["rms", "peak"] | None = Field(default=None, description="what the drive's ampere is")
    torque_constant_per: Literal["rms", "peak"] | None = Field(
        default=None, description="which ampere the torque constant of the cell file refers to"
    )
    torque_source: Text | None = Field(
        default=None, description="where these answers come from: manual and page, or `measured`"
    )
    counts_object: ObjectText | None = Field(
        default=None, description="object that holds the position counts of one motor revolution"
    )
    counts_per_revolution: Positive | None = Field(
        default=None, description="of 0x6064 and the motor, where no object holds them"
    )
    position_source: Text | None = Field(default=None, description="where the counts come from")
    velocity_unit_rad_s: Positive | None = Field(default=None, description="motor speed that one bit of 0x606C is")
    velocity_source: Text | None = Field(default=None, description="source of the value")
    ramp_counts_s2: Positive | None = Field(
        default=None, description="counts/s2 per bit of 0x6085, where it is not the velocity unit per second"
    )
    lost_heartbeat: Literal["quick stop", "disable voltage"] | None = Field(
        default=None, description="what stops the drive when the master's heartbeat is lost (0x6007)"
    )

    cyclic_mode: TypedMode | None = Field(
        default=None, description="mode of the setpoint stream where 0x6502 does not state it: 7 or 8"
    )
    ignored_status: Literal["0x0200", "0x0800", "0x0A00"] | None = Field(
        default=None, description="bits of the statusword without meaning: 0x0800 where a warning sets bit 11"
    )
    warning_codes: Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}(, ?0x[0-9A-Fa-f]{4})*$")] | None = Field(
        default=None, description="codes of emergency messages that only warn, such as 0x4310, 0x4390"
    )

    @property
    def torque_is_sourced(self) -> bool:
        """Return whether the torque scaling has a stated source."""
        return self.torque_source is not None and not is_assumed(self.torque_source)


def address_of(text: str) -> tuple[int, int]:
    """Index and subindex of `0x30D1:02`."""
    index, _, subindex = text.partition(":")
    return int(index, 16), int(subindex or "0", 16)
