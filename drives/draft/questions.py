"""Questions that an EDS cannot answer, and how an engineer finds the answers."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Final

from drives.draft.answers import ProfileAnswers, address_of
from drives.draft.device import Address, Device, velocity_unit_rad_s
from drives.objects import OBJECTS
from drives.profile import resolution
from drives.validation import Unfit, fitted

TORQUE, CURRENT = (OBJECTS[name].address for name in ("torque", "current"))
RATED: Final = {f"permille_{name}": OBJECTS[name].address for name in ("rated_torque", "rated_current")}
COUNTS: Final = tuple(OBJECTS[name].address for name in ("encoder_increments", "encoder_revolutions"))


#: Format of an answer: (reply, number of axes; 0 = unknown) -> the answer; raises ValueError with a message.
Form = Callable[[Any, int], Any]


@dataclass(frozen=True, slots=True)
class Question:
    """Question to the engineer about a value that neither files nor drives determine.

    Attributes
    ----------
    key : str
        Key in the answer file.
    asks : str
    ways : tuple of str
        Methods to find the answer.
    form : Form
        Format of the answer.
    """

    key: str
    asks: str
    ways: tuple[str, ...]
    form: Form


def answer_form(key: str) -> Form:
    """Return the format of an answer about a drive: its field of `ProfileAnswers`, read from text."""

    def read(reply: Any, _axes: int) -> Any:
        try:
            return getattr(fitted(ProfileAnswers, {key: reply}), key)
        except Unfit as error:
            raise ValueError("; ".join(problem.what for problem in error.problems)) from error

    return read


def torque_address(device: Device, answers: ProfileAnswers) -> Address | None:
    """Return the object of the measured torque: as answered, else 0x6077, else 0x6078; None = the sheet has neither."""
    if answers.torque_object is not None:
        return address_of(answers.torque_object)
    return next((address for address in (TORQUE, CURRENT) if device.has(*address)), None)


def is_current(answers: ProfileAnswers) -> bool:
    """Whether the torque is known to be a current."""
    return answers.torque_kind not in (None, "permille_rated_torque")


def rated_address(device: Device, answers: ProfileAnswers) -> Address | None:
    """Object that holds what 1000 per mille stand for; None = there is none."""
    kind = answers.torque_kind or "permille_rated_torque"
    if answers.rated_object is not None and kind in RATED:
        return address_of(answers.rated_object)
    address = RATED.get(kind)
    return address if address is not None and device.has(*address) else None


def _asks_unit(device: Device, answers: ProfileAnswers) -> bool:
    return answers.rated_value is None and rated_address(device, answers) is not None


def _asks_value(device: Device, answers: ProfileAnswers) -> bool:
    permille = answers.torque_kind is None or answers.torque_kind in RATED
    return permille and rated_address(device, answers) is None


def has_counts(device: Device) -> bool:
    """Return whether 0x608F holds the counts of a motor revolution; a drive that answers 1 for 1 has no value there."""
    counts, turns = (device.live.get(address) for address in COUNTS)
    return device.has(*COUNTS[0]) and (counts is None or resolution(counts, turns or 1) is not None)


def _asks_counts(device: Device, answers: ProfileAnswers) -> bool:
    return answers.counts_object is None and not has_counts(device)


Wanted = Callable[[Device, ProfileAnswers], bool]

_ROWS: Final[tuple[tuple[str, str, tuple[str, ...], Wanted], ...]] = (
    (
        "torque_object",
        "Which object holds the torque or current that is measured? The data sheet has neither 0x6077 nor 0x6078.",
        ("the manual's list of objects: look for `torque actual value` and `current actual value`",),
        lambda device, answers: torque_address(device, answers) is None,
    ),
    (
        "torque_kind",
        "What does it count in: per mille of the rated torque, per mille of the rated current, mA, or a unit of "
        "the drive's own? (permille_rated_torque, permille_rated_current, milliampere, internal_unit)",
        (
            "the manual's page on the object: what 1000 stands for",
            "on the drive: halve 0x6075 while it is disabled and hold the same load: a word that doubles is per "
            "mille of the rated current. Put 0x6075 back",
            "on the drive: a known weight on a known lever, word and torque side by side",
        ),
        lambda device, answers: True,
    ),
    (
        "torque_nature",
        "Is it the measured value or the controller's demand? (measured, demand)",
        (
            "the manual: `actual` values of some drives are the input of the torque controller",
            "on the drive: compare it with 0x6074; a measured value has noise that the demand has not",
        ),
        lambda device, answers: True,
    ),
    (
        "rated_unit",
        "How much is one bit of the rated value, 0x6076 in Nm or 0x6075 in A? (0.001 by CiA 402)",
        (
            "compare it with the motor's plate: 1.27 Nm shown as 1270 is 0.001, as 1270000 it is 0.000001",
            "the manual's page on 0x6076 or 0x6075",
        ),
        _asks_unit,
    ),
    (
        "rated_value",
        "How many Nm (or A) do 1000 per mille stand for? The data sheet has no object that holds it.",
        (
            "the motor's plate, if the manual says `rated torque of the motor`",
            "the drive's data sheet, if it is a current of the drive and not of the motor",
            "an object of the make's own that holds it: answer rated_object and rated_unit instead",
        ),
        _asks_value,
    ),
    (
        "internal_unit_a",
        "How many A is one bit?",
        ("the manual's chapter on internal units: often twice the drive's peak current over its range of numbers",),
        lambda device, answers: answers.torque_kind == "internal_unit",
    ),
    (
        "current_reference",
        "Is the drive's ampere a root mean square or a peak value? (rms, peak)",
        (
            "the manual's page on 0x6075 or on the motor's parameters: `Arms`, `amplitude`, `peak of the sine`",
            "on the drive: a current clamp on one phase of a motor that turns slowly: its peak is what the drive "
            "says (peak) or 1.414 times that (rms)",
        ),
        lambda device, answers: is_current(answers),
    ),
    (
        "torque_constant_per",
        "Does the motor's torque constant refer to rms or to peak ampere? (rms, peak)",
        (
            "the motor's data sheet: rated torque over rated current is the constant per ampere of that current",
            "`Arms` beside the constant means rms; constants of direct current motors are per peak",
        ),
        lambda device, answers: is_current(answers),
    ),
    (
        "torque_source",
        "Where do these answers come from? (manual and page, or `measured`)",
        ("without a source the drive is read and not moved",),
        lambda device, answers: True,
    ),
    (
        "counts_per_revolution",
        "How many counts of 0x6064 are one revolution of the motor?",
        (
            "the encoder's data sheet: lines times four, or two to the number of bits; and the drive's own scaling",
            "on the drive: turn the shaft once by hand and read 0x6064 before and after",
            "an object of the drive that holds it: answer counts_object instead",
        ),
        _asks_counts,
    ),
    (
        "velocity_unit_rad_s",
        "How many rad/s of the motor is one bit of 0x606C? (1 rpm is 0.10471975511965977; "
        "left open: the speed is not read, and a quick stop ramp is refused)",
        (
            "the manual's page on 0x606C or 0x60A9",
            "on the drive: turn the shaft at a known speed",
        ),
        lambda device, answers: device.has(0x606C) and velocity_unit_rad_s(device) is None,
    ),
    (
        "lost_heartbeat",
        "What shall stop the drive when the master's heartbeat is lost? (quick stop, disable voltage)",
        (
            "the manual's page on 0x6007: a drive that takes 2 (disable voltage) alone is read and not moved",
            "`servo-gateway check CELL --prove-stop` tests it; no other motion is allowed before it has passed",
        ),
        lambda device, answers: True,
    ),
)

_TABLE: Final = tuple((Question(key, asks, ways, answer_form(key)), wanted) for key, asks, ways, wanted in _ROWS)

#: All of them, in the order in which they are put.
QUESTIONS: Final = tuple(question for question, _ in _TABLE)


def open_questions(device: Device, answers: ProfileAnswers) -> tuple[Question, ...]:
    """Questions that matter for this drive and are not answered."""
    return tuple(
        question for question, wanted in _TABLE if getattr(answers, question.key) is None and wanted(device, answers)
    )


def next_question(device: Device, answers: ProfileAnswers, asked: Collection[str]) -> Question | None:
    """Return the first open question that was not asked yet."""
    return next((each for each in open_questions(device, answers) if each.key not in asked), None)
