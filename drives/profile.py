"""Drive profiles: what the master has to know of one drive model, as data (`profiles/*.toml`).

Every constant carries its source. A constant that is missing is an error: nothing is ever taken as 1.0.
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from drives.errors import ProfileError
from drives.objects import RPDO_COMMUNICATION, RPDO_MAPPING, SIZE_BYTES, TPDO_COMMUNICATION, TPDO_MAPPING, DataType
from drives.toml_text import parse_toml

PROFILE_FOLDER = Path(__file__).parent / "profiles"

Source = Annotated[str, Field(min_length=1, description="where the number comes from: datasheet page, read, assumed")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

#: Objects that no profile may allow: storing and restoring parameters is never the master's business.
_FORBIDDEN_WRITES = {0x1010: "storing parameters", 0x1011: "restoring factory parameters"}
#: Objects that the master writes on every drive.
_NEEDED_WRITES = (
    0x1016,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    0x6007,
    0x6040,
    0x6060,
    0x607A,
    0x60B2,
)


#: And beside them in a run with feedforward.
_FEEDFORWARD_WRITES = (RPDO_COMMUNICATION + 1, RPDO_MAPPING + 1, 0x60B1)


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Constant(_Strict):
    """A number and where it comes from."""

    value: Positive
    source: Source


class ObjectReference(_Strict):
    """An object that is read, written or mapped."""

    index: int = Field(ge=0x1000, le=0xFFFF)
    subindex: int = Field(default=0, ge=0, le=0xFF)
    type: DataType

    @property
    def size_bits(self) -> int:
        """Length in a PDO."""
        return 8 * SIZE_BYTES[self.type]

    @property
    def mapping(self) -> int:
        """Value of a PDO mapping entry: index, subindex, length (CiA 301, 7.5.2.36)."""
        return self.index << 16 | self.subindex << 8 | self.size_bits


class Identity(_Strict):
    """What 0x1018 must say; a key that is not given matches anything."""

    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    product_code: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    revision_min: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    revision_max: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)


class Rated(_Strict):
    """Rated torque (Nm) or rated current (A): read from the drive, or given."""

    object: ObjectReference | None = None
    unit: Positive | None = Field(default=None, description="Nm or A per least significant bit of `object`")
    value: Positive | None = Field(default=None, description="Nm or A")
    source: Source

    @model_validator(mode="after")
    def _one_of_two(self) -> Rated:
        if (self.object is None) == (self.value is None):
            raise ValueError("give either object and unit (read from the drive), or value")
        if (self.object is None) != (self.unit is None):
            raise ValueError("object and unit belong together: without the unit the number means nothing")
        return self


class Signal(_Strict):
    """A torque or current object and its arithmetic."""

    kind: Literal["permille_rated_torque", "permille_rated_current", "milliampere", "internal_unit"]
    object: ObjectReference
    nature: Literal["measured", "demand", "unknown"]
    signed: bool
    filter_s: float = Field(ge=0, description="time constant of the drive's own filter on this value")
    source: Source
    rated: Rated | None = None
    internal_unit_a: Constant | None = Field(default=None, description="ampere per unit, kind internal_unit")
    current_reference: Literal["rms", "peak"] | None = Field(default=None, description="what the drive's ampere is")
    torque_constant_per: Literal["rms", "peak"] | None = Field(
        default=None, description="which ampere the torque constant of the cell file refers to"
    )

    @property
    def is_current(self) -> bool:
        """Whether the object is a current, so that the torque constant is needed."""
        return self.kind != "permille_rated_torque"

    @property
    def current_factor(self) -> float:
        """Ampere of the torque constant per ampere of the drive: 1, sqrt(2) or 1/sqrt(2)."""
        if self.current_reference == self.torque_constant_per:
            return 1.0
        return math.sqrt(2.0) if self.current_reference == "rms" else math.sqrt(0.5)

    @model_validator(mode="after")
    def _complete(self) -> Signal:
        if self.kind.startswith("permille") and self.rated is None:
            raise ValueError(f"kind {self.kind} needs [..rated]: the value that 1000 per mille stands for")
        if (self.kind == "internal_unit") != (self.internal_unit_a is not None):
            raise ValueError("internal_unit_a belongs to kind internal_unit, and is needed there")
        references = (self.current_reference, self.torque_constant_per)
        if self.is_current and None in references:
            raise ValueError("a current needs current_reference and torque_constant_per (rms or peak)")
        if self.signed != self.object.type.startswith("i"):
            raise ValueError(f"signed = {self.signed} does not fit the object type {self.object.type}")
        return self


class TorqueOffset(_Strict):
    """Arithmetic of 0x60B2 where it differs from that of the measured torque."""

    kind: Literal["permille_rated_torque", "permille_rated_current"]
    rated: Rated
    current_reference: Literal["rms", "peak"] | None = None
    torque_constant_per: Literal["rms", "peak"] | None = None
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> TorqueOffset:
        references = (self.current_reference, self.torque_constant_per)
        if self.kind == "permille_rated_current" and None in references:
            raise ValueError("a current needs current_reference and torque_constant_per (rms or peak)")
        return self


class Share(_Strict):
    """A part of a whole and where the number comes from."""

    value: float = Field(ge=0, le=1, allow_inf_nan=False)
    source: Source


class Feedforward(_Strict):
    """What the drive takes beside the position: velocity offset 0x60B1 (in units of [velocity]), torque offset 0x60B2.

    `velocity_share` is the part of the commanded velocity that the drive's own loops feed forward: the master adds only
    the rest.
    """

    velocity_share: Share
    source: Source


class Velocity(_Strict):
    """The velocity object, motor side."""

    object: ObjectReference
    unit_rad_s: Constant


class CountsFromObjects(_Strict):
    """Encoder resolution read from the drive: object / per."""

    object: ObjectReference
    per: ObjectReference


class Position(_Strict):
    """The position object and the counts of one motor revolution."""

    object: ObjectReference = ObjectReference(index=0x6064, type="i32")
    counts_per_revolution: CountsFromObjects | Constant

    @model_validator(mode="after")
    def _standard_object(self) -> Position:
        if self.object.type != "i32":
            raise ValueError("the position object must be of type i32, as the target position 0x607A is")
        return self


class StateMachine(_Strict):
    """Times and habits of the CiA 402 state machine."""

    transition_timeout_s: Positive
    mode_before_enable: bool = True
    brake_delay_s: float = Field(default=0.0, ge=0)


class SdoTimes(_Strict):
    """How long an answer may take."""

    timeout_s: Positive
    slow_timeout_s: Positive

    @model_validator(mode="after")
    def _ordered(self) -> SdoTimes:
        if self.slow_timeout_s < self.timeout_s:
            raise ValueError("slow_timeout_s must not be shorter than timeout_s")
        return self


class Heartbeat(_Strict):
    """How the drive watches the master (0x1016, 0x6007), and how the master watches the drive (0x1017)."""

    consumer_ms: int = Field(ge=10, le=65535)
    abort_connection: Literal[2, 3] = Field(description="0x6007: 2 disable voltage, 3 quick stop")
    producer_ms: int | None = Field(default=None, ge=10, le=65535, description="0x1017, left alone if absent")


class Write(_Strict):
    """Every object that the master may write."""

    allow: tuple[Annotated[int, Field(ge=0x1000, le=0xFFFF)], ...]

    @model_validator(mode="after")
    def _safe(self) -> Write:
        for index, meaning in _FORBIDDEN_WRITES.items():
            if index in self.allow:
                raise ValueError(f"allow must not hold 0x{index:04X}: {meaning} is left to the engineer")
        missing = [f"0x{index:04X}" for index in _NEEDED_WRITES if index not in self.allow]
        if missing:
            raise ValueError(f"allow lacks {', '.join(missing)}, which bringing the drive up needs")
        return self


class EmcyEntry(_Strict):
    """What an emergency code means on this drive."""

    code: int = Field(ge=0, le=0xFFFF)
    text: str
    advice: str


class DriveProfile(_Strict):
    """Everything the master has to know of one drive model."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
    description: str
    source: Source
    eds: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*\.eds$")] | None = None
    identity: Identity = Identity()
    torque: Signal
    current: Signal | None = None
    torque_offset: TorqueOffset | None = None
    velocity: Velocity | None = None
    feedforward: Feedforward | None = Field(
        default=None, description="absent: the drive has no 0x60B1, or it is not known how it takes it"
    )
    position: Position
    state_machine: StateMachine
    sdo: SdoTimes
    heartbeat: Heartbeat
    write: Write
    emcy: tuple[EmcyEntry, ...] = ()
    _text: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=PROFILE_FOLDER)

    @property
    def text(self) -> str:
        """The TOML this profile was read from, for the recording."""
        return self._text

    @property
    def eds_path(self) -> Path | None:
        """Path of the electronic data sheet, if the profile names one."""
        return None if self.eds is None else self._folder / self.eds

    @property
    def needs_torque_constant(self) -> bool:
        """Whether the measured torque is a current times the torque constant of the cell file."""
        return self.torque.is_current

    def emcy_entry(self, code: int) -> EmcyEntry | None:
        """The entry of an emergency code, None if the profile does not know it."""
        return next((entry for entry in self.emcy if entry.code == code), None)

    @model_validator(mode="after")
    def _consistent(self) -> DriveProfile:
        if self.current is not None and not self.current.is_current:
            raise ValueError("current: kind permille_rated_torque is not a current")
        if self.heartbeat.producer_ms is not None and 0x1017 not in self.write.allow:
            raise ValueError("heartbeat.producer_ms needs 0x1017 in write.allow")
        second = TPDO_COMMUNICATION + 1 in self.write.allow and TPDO_MAPPING + 1 in self.write.allow
        if (self.current is not None or self.torque.object.size_bits > 16) and not second:
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


def list_profiles() -> list[str]:
    """Names of the profiles that come with the package, sorted."""
    return sorted(path.stem for path in PROFILE_FOLDER.glob("*.toml"))


def load_profile(name_or_path: str | Path) -> DriveProfile:
    """Read one profile.

    Parameters
    ----------
    name_or_path : str or Path
        A name of `list_profiles`, or the path of a TOML file.

    Raises
    ------
    ProfileError
        No such profile, not TOML, an unknown key, a missing constant; every problem of the file at once.
    """
    path = Path(name_or_path)
    packaged = PROFILE_FOLDER / f"{name_or_path}.toml"
    if path.suffix != ".toml" and packaged.is_file():
        path = packaged
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        known = ", ".join(list_profiles())
        advice = f"give the path of a TOML file or one of {known}"
        raise ProfileError(f"drive profile '{name_or_path}' cannot be read: {error}", advice=advice) from error
    return parse_profile(text, str(path), path.parent)


def parse_profile(text: str, where: str, folder: Path = PROFILE_FOLDER) -> DriveProfile:
    """Validate the text of a profile.

    Parameters
    ----------
    text : str
        TOML.
    where : str
        File name for messages.
    folder : Path
        Where the EDS that the profile names is looked for.

    Raises
    ------
    ProfileError
        Every problem of the file at once.
    """
    try:
        profile = DriveProfile.model_validate(parse_toml(text))
    except tomllib.TOMLDecodeError as error:
        raise ProfileError(f"{where}: not valid TOML: {error}", advice="correct the file") from error
    except ValidationError as error:
        advice = "see drives/profiles/README.md, or `servo-gateway profiles schema`"
        raise ProfileError(f"{where}: {_in_words(error)}", advice=advice) from error
    object.__setattr__(profile, "_text", text)
    object.__setattr__(profile, "_folder", folder)
    if profile.eds_path is not None:
        from drives.eds import check_eds  # imported here: it needs the classes of this file

        check_eds(profile, profile.eds_path)
    return profile


def profile_schema() -> dict[str, Any]:
    """JSON schema of the profile file."""
    return DriveProfile.model_json_schema()


def _in_words(error: ValidationError) -> str:
    lines = []
    for problem in error.errors(include_url=False):
        key = ".".join(str(part) for part in problem["loc"]) or "file"
        message = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            message = "unknown key; remove it or correct its spelling"
        elif problem["type"] == "missing":
            message = "is missing; nothing is assumed in its place"
        lines.append(f"{key}: {message}")
    return "; ".join(lines)
