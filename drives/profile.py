"""Drive profiles: data of one drive model that the master needs (`profiles/*.toml`).

Every constant carries its source. A constant that is missing is an error: nothing is ever taken as 1.0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field, PrivateAttr, model_validator

from drives.objects import (
    OBJECTS,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    SIZE_BYTES,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    DataType,
)
from drives.validation import Strict

Source = Annotated[str, Field(min_length=1, description="source of the number: datasheet page, read, assumed")]
#: What an arithmetic rests upon.
Basis = Literal["standard", "manual", "measured", "code", "assumed"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]

#: Objects that no profile may allow: storing and restoring parameters is never the master's business.
_FORBIDDEN_WRITES = {0x1010: "storing parameters", 0x1011: "restoring factory parameters"}
#: Objects that the master writes on every drive.
_NEEDED = {RPDO_COMMUNICATION, RPDO_MAPPING, TPDO_COMMUNICATION, TPDO_MAPPING, 0x6040, 0x6060}
_WATCHDOG = {"heartbeat": ("consumer_heartbeat",), "node guarding": ("guard_time", "life_time_factor")}
#: Modes of operation (0x6060) in which the master streams setpoints.
CyclicMode = Literal[7, 8]
#: How a drive notices that the master is gone.
Watchdog = Literal["heartbeat", "node guarding"]


def loss_objects(watchdog: Watchdog, *, has_option: bool) -> tuple[str, ...]:
    """Return the names of the objects that state how a drive acts on the loss of its master: 0x6007 if it has one."""
    return (*_WATCHDOG[watchdog], *(("abort_connection_option",) if has_option else ()))


def needed_writes(mode: CyclicMode, watchdog: Watchdog, *, has_option: bool) -> tuple[int, ...]:
    """Return the objects that the master writes on every drive of this mode and watchdog, in ascending order."""
    lost = {OBJECTS[name].index for name in loss_objects(watchdog, has_option=has_option)}
    return tuple(sorted(_NEEDED | {_TARGET_POSITION[mode].index} | lost))


def is_assumed(source: str) -> bool:
    """Return whether a source is stated as assumed."""
    return source.strip().lower().startswith("assumed")


class Constant(Strict):
    """A number and its source."""

    value: Positive = Field(description="in the unit of the key")
    source: Source


class ObjectReference(Strict):
    """An object that is read, written or mapped."""

    index: int = Field(ge=0x1000, le=0xFFFF, description="of the object dictionary, such as 0x6077")
    subindex: int = Field(default=0, ge=0, le=0xFF, description="of that object")
    type: DataType = Field(description="of its value; a PDO entry is as long")

    @property
    def size_bits(self) -> int:
        """Length in a PDO."""
        return 8 * SIZE_BYTES[self.type]

    @property
    def mapping(self) -> int:
        """Value of a PDO mapping entry: index, subindex, length (CiA 301, 7.5.2.36)."""
        return self.index << 16 | self.subindex << 8 | self.size_bits


#: Target position by mode of operation: 7 interpolated position, 8 cyclic synchronous position.
_TARGET_POSITION: Final[dict[CyclicMode, ObjectReference]] = {
    7: ObjectReference(index=0x60C1, subindex=1, type="i32"),
    8: ObjectReference(index=0x607A, type="i32"),
}


#: Why an encoder resolution is refused.
NO_RESOLUTION: Final = "encoder resolution is missing, zero or 1:1 as delivered without a motor"
#: Reads an object of a drive, or looks it up among objects that were read; None where the drive does not have it.
Reader = Callable[[ObjectReference], int | None]


def resolution(increments: float | None, turns: int | None) -> float | None:
    """Return the position counts of one motor revolution from the two entries of 0x608F.

    None where they hold no resolution: one is missing or zero, or there is no more than one count in a revolution. 1:1
    is how drives are delivered without a motor.
    """
    return increments / turns if increments and turns and increments > turns else None


class ExpectedIdentity(Strict):
    """Expected content of 0x1018; a key that is not given matches anything."""

    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFFFFFF, description="0x1018:01")
    product_code: int | None = Field(default=None, ge=0, le=0xFFFFFFFF, description="0x1018:02")
    revision_min: int | None = Field(default=None, ge=0, le=0xFFFFFFFF, description="lowest 0x1018:03 that is known")
    revision_max: int | None = Field(default=None, ge=0, le=0xFFFFFFFF, description="highest 0x1018:03 that is known")


class Rated(Strict):
    """Rated torque (Nm) or rated current (A): read from the drive, or given."""

    object: ObjectReference | None = Field(default=None, description="read from here; either this or `value`")
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

    def amount(self, read: Reader) -> float | None:
        """Return what 1000 per mille stand for [Nm or A]; None where the drive has no object for it, or zero in it."""
        if self.object is None:
            return self.value
        word = read(self.object)
        return word * self.unit if word and word > 0 and self.unit else None


class Signal(Strict):
    """A torque or current object and its arithmetic."""

    kind: Literal["permille_rated_torque", "permille_rated_current", "milliampere", "internal_unit"] = Field(
        description="what one bit is"
    )
    object: ObjectReference = Field(description="where the value is")
    nature: Literal["measured", "demand", "unknown"] = Field(description="only `measured` is used for estimation")
    signed: bool = Field(description="must fit the object's type")
    filter_s: float = Field(ge=0, description="time constant of the drive's own filter on this value")
    source: Source
    basis: Basis | None = Field(
        default=None,
        description="what the arithmetic rests upon: CiA 402, the maker's manual, a trial on the drive, public code, "
        "or nothing: `assumed` is read and not moved. Absent: it is assumed where `source` begins with that word",
    )
    rated: Rated | None = Field(default=None, description="what 1000 per mille stand for")
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
    def assumed(self) -> bool:
        """Return whether the value of one bit is assumed."""
        if self.basis is not None:
            return self.basis == "assumed"
        parts = (self.rated, self.internal_unit_a)
        return is_assumed(self.source) or any(part is not None and is_assumed(part.source) for part in parts)

    @model_validator(mode="after")
    def _complete(self) -> Signal:
        if self.kind.startswith("permille") and self.rated is None and not self.assumed:
            raise ValueError(f"kind {self.kind} needs [..rated]: the value that 1000 per mille stands for")
        if (self.kind == "internal_unit") != (self.internal_unit_a is not None) and not self.assumed:
            raise ValueError("internal_unit_a belongs to kind internal_unit, and is needed there")
        references = (self.current_reference, self.torque_constant_per)
        if self.is_current and None in references and not self.assumed:
            raise ValueError("a current needs current_reference and torque_constant_per (rms or peak)")
        if self.signed != self.object.type.startswith("i"):
            raise ValueError(f"signed = {self.signed} does not fit the object type {self.object.type}")
        return self


class TorqueOffsetWord(Strict):
    """Arithmetic of 0x60B2 where it differs from that of the measured torque."""

    kind: Literal["permille_rated_torque", "permille_rated_current"] = Field(description="what one bit of 0x60B2 is")
    rated: Rated = Field(description="what 1000 per mille stand for")
    current_reference: Literal["rms", "peak"] | None = Field(default=None, description="what the drive's ampere is")
    torque_constant_per: Literal["rms", "peak"] | None = Field(
        default=None, description="which ampere the torque constant of the cell file refers to"
    )
    source: Source

    @model_validator(mode="after")
    def _complete(self) -> TorqueOffsetWord:
        references = (self.current_reference, self.torque_constant_per)
        if self.kind == "permille_rated_current" and None in references:
            raise ValueError("a current needs current_reference and torque_constant_per (rms or peak)")
        return self


def current_factor(word: Signal | TorqueOffsetWord) -> float:
    """Return the ampere of the torque constant per ampere of the drive: 1, sqrt(2) or 1/sqrt(2)."""
    if word.current_reference == word.torque_constant_per:
        return 1.0
    return math.sqrt(2.0) if word.current_reference == "rms" else math.sqrt(0.5)


class Share(Strict):
    """A fraction and its source."""

    value: float = Field(ge=0, le=1, allow_inf_nan=False, description="0 to 1")
    source: Source


class Feedforward(Strict):
    """What the drive takes beside the position: velocity offset 0x60B1 (in units of [velocity]), torque offset 0x60B2.

    `velocity_share` is the part of the commanded velocity that the drive's own loops feed forward: the master adds only
    the rest.
    """

    velocity_share: Share = Field(description="part of the commanded velocity that the drive feeds forward itself")
    source: Source


class Velocity(Strict):
    """The velocity object, motor side."""

    object: ObjectReference = Field(description="where the value is")
    unit_rad_s: Constant | None = Field(default=None, description="speed of the motor that one bit means")
    unit_counts_s: Constant | None = Field(
        default=None, description="instead of it: position counts per second that one bit means"
    )
    ramp_counts_s2: Constant | None = Field(
        default=None,
        description="counts/s2 that one bit of 0x6084 and 0x6085 means; absent: the velocity's unit per second",
    )

    def rad_s(self, counts_per_revolution: float | None) -> float | None:
        """Speed of the motor that one bit means [rad/s]; None where that needs the counts of a revolution."""
        if self.unit_rad_s is not None:
            return self.unit_rad_s.value
        return _turned_rad(self.unit_counts_s, counts_per_revolution)

    def ramp_rad_s2(self, counts_per_revolution: float | None) -> float | None:
        """Deceleration of the motor that one bit means [rad/s2]; None where that needs the counts of a revolution."""
        if self.ramp_counts_s2 is None:
            return self.rad_s(counts_per_revolution)
        return _turned_rad(self.ramp_counts_s2, counts_per_revolution)

    @model_validator(mode="after")
    def _one_unit(self) -> Velocity:
        if (self.unit_rad_s is None) == (self.unit_counts_s is None):
            raise ValueError("give either unit_rad_s or unit_counts_s")
        return self


class Temperature(Strict):
    """The temperature object. It is read now and then while the arm is measured, and never needed."""

    object: ObjectReference = Field(description="where the value is")
    unit_c: Constant = Field(description="degrees Celsius that one bit means")
    of: Literal["motor", "drive"] = Field(description="where the sensor is: motor winding or power stage")


def _turned_rad(counts: Constant | None, counts_per_revolution: float | None) -> float | None:
    if counts is None or not counts_per_revolution:
        return None
    return counts.value * 2.0 * math.pi / counts_per_revolution


class CountsFromObjects(Strict):
    """Encoder resolution read from the drive: object / per."""

    object: ObjectReference = Field(description="counts, such as 0x608F:01")
    per: ObjectReference | None = Field(
        default=None, description="in so many motor revolutions, such as 0x608F:02; absent: in one"
    )


class Position(Strict):
    """The position object and the counts of one motor revolution."""

    object: ObjectReference = Field(
        default=ObjectReference(index=0x6064, type="i32"), description="actual position; 0x6064 if absent"
    )
    counts_per_revolution: CountsFromObjects | Constant = Field(
        description="of the motor: read from the drive, or given"
    )

    @model_validator(mode="after")
    def _standard_object(self) -> Position:
        if self.object.type != "i32":
            raise ValueError("the position object must be of type i32, as the target position 0x607A is")
        return self

    def counts(self, read: Reader) -> float | None:
        """Return the position counts of one motor revolution; None where the drive holds no resolution."""
        known = self.counts_per_revolution
        if isinstance(known, Constant):
            return resolution(known.value, 1)
        return resolution(read(known.object), 1 if known.per is None else read(known.per))


class StateMachine(Strict):
    """Times and behaviour of the CiA 402 state machine."""

    transition_timeout_s: Positive = Field(description="longest wait for a change of state")
    cyclic_mode: CyclicMode = Field(
        default=8,
        description="mode of the setpoint stream (0x6060): 8 cyclic synchronous position (0x607A), 7 interpolated "
        "position (0x60C1:01, started by bit 4 of the controlword)",
    )
    ignored_status: Literal[0, 0x0200, 0x0800, 0x0A00] = Field(
        default=0,
        description="bits of the statusword that say nothing on this drive: 0x0800 where a warning sets bit 11",
    )
    brake_delay_s: float = Field(
        default=0.0, ge=0, description="time from operation enabled until the brake has opened"
    )
    brake_closing_s: float = Field(
        default=0.1,
        ge=0,
        le=2,
        description="time from the end of operation enabled until the brake has closed; until then the axis stays in "
        "SWITCHED ON, and the voltage is not disabled",
    )


class SdoTimes(Strict):
    """How long an answer may take."""

    timeout_s: Positive = Field(description="of an answer")
    slow_timeout_s: Positive = Field(description="of the answer to a value that is put back")

    @model_validator(mode="after")
    def _ordered(self) -> SdoTimes:
        if self.slow_timeout_s < self.timeout_s:
            raise ValueError("slow_timeout_s must not be shorter than timeout_s")
        return self


class Heartbeat(Strict):
    """How the drive watches the master (0x1016 or 0x100C, and 0x6007), and the master the drive (0x1017)."""

    watchdog: Watchdog = Field(
        default="heartbeat",
        description="what the drive watches: the master's heartbeat (0x1016), or its node guarding (0x100C x 0x100D)",
    )
    consumer_ms: int = Field(
        ge=10, le=65535, description="after this time without a sign of the master the drive treats it as lost"
    )
    abort_connection: Literal[1, 2, 3] | None = Field(
        default=None,
        description="0x6007: 3 quick stop, 1 fault (then 0x605E); a drive with 2, disable voltage, is read and not "
        "moved; absent: the drive has no 0x6007, and the proof of its stop shows what it does",
    )
    producer_ms: int | None = Field(
        default=None, ge=10, le=65535, description="0x1017, left alone if absent; none beside node guarding"
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> Heartbeat:
        if self.watchdog == "node guarding" and self.producer_ms is not None:
            raise ValueError("producer_ms: a node with a heartbeat does not answer node guarding (CiA 301)")
        return self


class Write(Strict):
    """Every object that the master may write."""

    allow: tuple[Annotated[int, Field(ge=0x1000, le=0xFFFF)], ...] = Field(description="indices; no other is written")

    @model_validator(mode="after")
    def _safe(self) -> Write:
        for index, meaning in _FORBIDDEN_WRITES.items():
            if index in self.allow:
                raise ValueError(f"allow must not hold 0x{index:04X}: {meaning} is left to the engineer")
        return self


class Condition(Strict):
    """A state of the drive that must hold for motion: the bits of `mask` in the object's value are those of `good`."""

    object: ObjectReference = Field(description="where the state is shown")
    mask: int = Field(gt=0, le=0xFFFFFFFF, description="which bits of the value are looked at")
    good: int = Field(ge=0, le=0xFFFFFFFF, description="what these bits are when all is well")
    source: Source | None = Field(default=None, description="where it comes from: manual and page")

    def holds(self, value: int) -> bool:
        """Return whether a value of the object satisfies the condition."""
        return value & self.mask == self.good

    def describe(self, value: int) -> str:
        """Describe a value, for a message."""
        where = f"{self.object.index:04X}:{self.object.subindex:02X}"
        return f"{where} & {self.mask:#x} is {value & self.mask:#x} instead of {self.good:#x}"

    @model_validator(mode="after")
    def _inside(self) -> Condition:
        if self.good & ~self.mask:
            raise ValueError(f"good = {self.good:#x} has bits that mask = {self.mask:#x} does not look at")
        if self.mask >> self.object.size_bits:
            raise ValueError(f"mask = {self.mask:#x} is wider than the object of {self.object.size_bits} bits")
        return self


class SafetyCondition(Condition):
    """A condition of the safety chain, e.g. emergency stop released, safe torque off not active."""

    what: Annotated[str, Field(min_length=1, description="what does not hold, e.g. STO or emergency stop")]


class Reference(Condition):
    """How the drive reports whether its encoder is referenced."""

    #: As `SafetyCondition.what`.
    what: ClassVar[str] = "the encoder is not referenced"


class EmcyEntry(Strict):
    """What an emergency code means on this drive."""

    code: int = Field(ge=0, le=0xFFFF, description="as the emergency message carries it")
    text: str = Field(description="what it means")
    advice: str = Field(description="what to do")
    warning: bool = Field(default=False, description="the drive only warns: the axes go on")


#: And beside them in a run with feedforward.
_FEEDFORWARD_WRITES = (RPDO_COMMUNICATION + 1, RPDO_MAPPING + 1, 0x60B1, 0x60B2)


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
    def needed_writes(self) -> tuple[int, ...]:
        """Return the objects that the master writes on every drive of this profile."""
        has_option = self.heartbeat.abort_connection is not None
        return needed_writes(self.state_machine.cyclic_mode, self.heartbeat.watchdog, has_option=has_option)

    @property
    def target_position(self) -> ObjectReference:
        """Return the object that takes the target position of each SYNC."""
        return _TARGET_POSITION[self.state_machine.cyclic_mode]

    @property
    def loss_objects(self) -> tuple[str, ...]:
        """Return the names of the objects that state how the drive acts on the loss of its master."""
        return loss_objects(self.heartbeat.watchdog, has_option=self.heartbeat.abort_connection is not None)

    @property
    def needs_torque_constant(self) -> bool:
        """Whether the measured torque is a current times the torque constant of the cell file."""
        return self.torque.is_current

    @property
    def constant_objects(self) -> tuple[ObjectReference, ...]:
        """Return the objects that hold constants of a drive: rated values and encoder resolution."""
        counts = self.position.counts_per_revolution
        objects = [counts.object, counts.per] if isinstance(counts, CountsFromObjects) else []
        for word in (self.torque, self.current, self.torque_offset):
            if word is not None and word.rated is not None:
                objects.append(word.rated.object)
        return tuple(each for each in objects if each is not None)

    def rated_torque_nm(self, read: Reader) -> float | None:
        """Return the motor torque of 1000 per mille of 0x6072 [Nm]; None where it is not known."""
        words = (self.torque, self.torque_offset)
        rated = [word.rated for word in words if word is not None and word.kind == "permille_rated_torque"]
        return next((each.amount(read) for each in rated if each is not None), None)

    def rated_current_a(self, read: Reader) -> float | None:
        """Return the current of 1000 per mille of 0x6073 [A, as the torque constant takes it]; None: not known."""
        signals = [each for each in (self.current, self.torque) if each is not None]
        signal = next((each for each in signals if each.kind == "permille_rated_current"), None)
        rated_a = None if signal is None or signal.rated is None else signal.rated.amount(read)
        return None if signal is None or rated_a is None else rated_a * current_factor(signal)

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

    @property
    def conditions(self) -> tuple[SafetyCondition | Reference, ...]:
        """Return the conditions for motion: safety chain, referenced encoder."""
        return (*self.safety, *(() if self.reference is None else (self.reference,)))

    def emcy_entry(self, code: int) -> EmcyEntry | None:
        """Return the entry of an EMCY code, or None if the profile does not list it."""
        return next((entry for entry in self.emcy if entry.code == code), None)

    @model_validator(mode="after")
    def _consistent(self) -> DriveProfile:
        missing = [f"0x{index:04X}" for index in self.needed_writes if index not in self.write.allow]
        if missing and not self.no_motion:
            raise ValueError(f"write.allow lacks {', '.join(missing)}, which bringing the drive up needs")
        if self.current is not None and not self.current.is_current:
            raise ValueError("current: kind permille_rated_torque is not a current")
        if self.heartbeat.producer_ms is not None and 0x1017 not in self.write.allow:
            raise ValueError("heartbeat.producer_ms needs 0x1017 in write.allow")
        second = TPDO_COMMUNICATION + 1 in self.write.allow and TPDO_MAPPING + 1 in self.write.allow
        if (self.current is not None or self.torque.object.size_bits > 16) and not (second or self.no_motion):
            raise ValueError("a second TPDO is needed: write.allow lacks 0x1801 and 0x1A01")
        codes = [0, *(entry.code for entry in self.emcy)]
        if repeated := [code for number, code in enumerate(codes) if code in codes[:number]]:
            what = f"emcy: code 0x{repeated[0]:04X} is listed twice or is no error: write each code once, 0x0000 never"
            raise ValueError(what)
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
