"""Answers from options, an answer file and the terminal: their sources, proposed values, and what is missing.

An answer file is TOML: one key per question (`questions.ALL`), a value for all axes or a list, and the source of a
constant as `{ value = 101, source = "data sheet p. 4" }`.

Errors of unit are detected at the input: values that the cell file refuses are refused here.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from drives.draft.answers import ADVICE, ProfileAnswers
from drives.draft.questions import Question, answer_form
from drives.errors import ProfileError
from drives.profile import is_assumed
from drives.profile_file import find_profile, list_profiles
from drives.toml_lines import key_lines
from drives.toml_text import parse_toml, toml_string
from drives.validation import Unfit, fitted, not_toml
from gateway.cell.config import ArmConfig, AxisConfig, BusConfig, Cell, DhTable
from gateway.errors import ConfigError
from gateway.model.load_bounds import NO_ARM, LoadBounds
from gateway.newcell import questions
from gateway.newcell.forms import SOURCE, VALUE, plain_text, with_source

ASSUMED: Final = "assumed"
#: Instead of a URDF: the arm is described by Denavit-Hartenberg parameters.
DH: Final = "dh"
UNSOURCED: Final = "stated, source not given"


@dataclass(frozen=True, slots=True)
class Answer:
    """A value in the form of its question, with its source; a source that begins with `assumed` marks an assumption."""

    value: Any
    source: str

    @property
    def guessed(self) -> bool:
        """Return whether the value is assumed."""
        return is_assumed(self.source)


@dataclass(frozen=True, slots=True)
class GivenAnswer:
    """An answer as written: TOML value, location, and the folder of relative file names."""

    value: Any
    where: str
    folder: Path


#: Asks at the terminal: question, value used if the input is empty, number of this question, largest number of
#: questions (known values are not asked), and the reader of a typed TOML value, which raises ValueError with a message.
#: None = the proposed value is used.
Ask = Callable[[Question, Answer | None, int, int, Callable[[Any], Answer]], Answer | None]


class CellAnswers:
    """All answers so far.

    Parameters
    ----------
    stated : mapping
        Key -> answer from options and answer file.
    missing_in : str
        Place to write a missing answer.
    ask : callable, optional
        Asks for missing answers; None = proposed values are used.
    resumed : mapping
        Key -> stored answers of an earlier run; an invalid one is asked again.

    Attributes
    ----------
    taken : dict
        Key -> the answer, proposed values included, in the order of the questions.
    said : dict
        Key -> the explicit answers among them.
    bounds : LoadBounds
        Plausibility bounds of stated loads.
    typed : int
        Number of answers typed in this run.
    """

    def __init__(
        self,
        stated: Mapping[str, GivenAnswer],
        missing_in: str,
        ask: Ask | None = None,
        resumed: Mapping[str, GivenAnswer] | None = None,
    ) -> None:
        self._explicit, self._missing_in, self._ask = dict(stated), missing_in, ask
        self._resumed = dict(resumed or {})
        self._asked = self.typed = 0
        self.taken: dict[str, Answer] = {}
        self.said: dict[str, Answer] = {}
        self.bounds = NO_ARM

    def settle(self, wanted: Sequence[tuple[Question, Answer | None]], axes: int = 0) -> None:
        """Resolve questions, each with a proposed value.

        Raises
        ------
        ConfigError
            Some answers are invalid or missing; the error lists all of them.
        """
        problems: list[str] = []
        for question, offer in wanted:
            try:
                answer = self._answer(question, offer, axes)
            except ValueError as error:
                problems.append(str(error))
                continue
            if answer is None:
                problems.append(f"{self._missing_in}: {question.key} is missing: {question.asks} ({question.ways[0]})")
                continue
            self.taken[question.key] = answer
        if problems:
            raise ConfigError.of(problems)

    def value(self, question: Question) -> Any:
        """Return the value of a resolved question."""
        return self.taken[question.key].value

    def _answer(self, question: Question, offer: Answer | None, axes: int) -> Answer | None:
        stated = self._explicit.get(question.key)
        if stated is not None:
            answer = self._read(question, stated, axes)
        else:
            answer = self._kept(question, axes)
            if answer is None and (self._ask is None or (offer is not None and not offer.guessed)):
                return offer
            if answer is None and self._ask is not None:
                answer = self._person(self._ask, question, offer, axes)
            if answer is None:
                return offer
        self.said[question.key] = answer
        return answer

    def _kept(self, question: Question, axes: int) -> Answer | None:
        """Return the answer of an earlier run, if still valid."""
        kept = self._resumed.get(question.key)
        try:
            return None if kept is None else self._verified(question, kept, axes)
        except ValueError:
            return None

    def _person(self, ask: Ask, question: Question, offer: Answer | None, axes: int) -> Answer | None:
        """Ask at the terminal; the answer is checked against files and profiles at once."""
        here = Path.cwd()
        self._asked += 1
        done = {*self.taken, *self._explicit, *(each.key for each in questions.UNASKED), question.key}
        rows = () if self.taken.get(questions.ROBOT.key, Answer("", "")).value == DH else questions.DH_KEYS
        left = [key for key in questions.KEYS if key not in done and key not in rows]

        def read(value: Any) -> Answer:
            return self._verified(question, GivenAnswer(value, "", here), axes)

        answer = ask(question, offer, self._asked, self._asked + len(left), read)
        self.typed += answer is not None
        return answer

    def _verified(self, question: Question, stated: GivenAnswer, axes: int) -> Answer:
        """Return an answer after checking its files; profile names are completed.

        Raises
        ------
        ValueError
            In words.
        """
        answer = self._read(question, stated, axes)
        try:
            if question is questions.PROFILE:
                names = tuple(completed_profile(name) for name in answer.value)
                for name in set(names):
                    find_profile(name, stated.folder)
                return Answer(names, answer.source)
        except ProfileError as error:
            raise ValueError(f"{question.key}: {error}") from error
        if question is questions.ROBOT and answer.value != DH and not Path(answer.value).is_file():
            raise ValueError(f"{question.key}: file {answer.value} not found")
        return answer

    def _read(self, question: Question, given: GivenAnswer, axes: int) -> Answer:
        value, source = with_source(given.value, question.form)
        where = f"{given.where}: " if given.where else ""
        try:
            answer = question.form(value, axes)
        except ValueError as error:
            raise ValueError(f"{where}{question.key} {error}: {question.asks}") from error
        gears = self.taken.get(questions.GEAR_RATIO.key)
        wrong = refusals(question.key, answer, gears.value if gears is not None else (), self.bounds)
        if wrong:
            raise ValueError(f"{where}{'; '.join(wrong)}")
        if question.key in questions.FILES:
            answer = _placed(answer, given.folder)
        return Answer(answer, source or UNSOURCED)


def _placed(value: Any, folder: Path) -> Any:
    """Resolve file names relative to the folder of the answer file; profile names and `dh` stay."""
    if isinstance(value, tuple):
        return tuple(_placed(part, folder) for part in cast("tuple[str, ...]", value))
    return value if value == DH or value in list_profiles() else str(folder / value)


def completed_profile(name: str) -> str:
    """Return the built-in profile for a path or an abbreviation; other names unchanged.

    Raises
    ------
    ValueError
        The file does not exist; the message proposes similar profiles.
    """
    stem, known = Path(name).name, list_profiles()
    if name in known or Path(name).is_file() or Path(f"{name}.toml").is_file():
        return name
    begun = [each for each in known if each.startswith(stem)]
    if len(begun) == 1:
        return begun[0]
    near = begun or difflib.get_close_matches(stem, known, 3, 0.5)
    said = f"did you mean {' or '.join(near)}?" if near else f"built-in profiles: {', '.join(known)}"
    raise ValueError(f"profile: '{stem}' is neither a built-in profile nor a file; {said}")


def given_answers(path: Path | None, typed: Mapping[str, str], known: Collection[str]) -> dict[str, GivenAnswer]:
    """Return the answers of a file, and of --answer, which take precedence.

    Raises
    ------
    ConfigError
        The file cannot be read, is not TOML, or there are unknown keys; the error lists all of them.
    """
    given: dict[str, GivenAnswer] = {}
    if path is not None:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: cannot be read: {error}; give an answer file") from error
        try:
            table = parse_toml(text)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError.of(not_toml(text, error).messages(str(path))) from error
        lines, folder = key_lines(text), path.resolve().parent
        given = {key: GivenAnswer(value, f"{path} line {lines[key,]}", folder) for key, value in table.items()}
    given |= {key: GivenAnswer(text, f"--answer {key}", Path.cwd()) for key, text in typed.items()}
    problems: list[str] = []
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            advice = f"write {near[0]}" if near else f"known keys: {', '.join(known)}"
            problems.append(f"{given[key].where}: unknown key {key}; {advice}")
    if problems:
        raise ConfigError.of(problems)
    return given


def profile_answers(path: Path | None, typed: Mapping[str, str]) -> ProfileAnswers:
    """Return the answers about a drive, of a file and of --answer.

    Raises
    ------
    ConfigError
        As `given_answers`, or invalid answers; the error lists all of them.
    """
    answers: dict[str, Any] = {}
    problems: list[str] = []
    for key, reply in given_answers(path, typed, ProfileAnswers.model_fields).items():
        try:
            answers[key] = answer_form(key)(plain_text(reply.value), 0)
        except ValueError as error:
            problems.append(f"{reply.where}: {error}; {ADVICE}")
    if problems:
        raise ConfigError.of(problems)
    return ProfileAnswers(**answers)


def answers_text(answers: CellAnswers, files: Callable[[str], str]) -> str:
    """Return the answers of a run as answer file: explicit answers as keys, assumed values as comments.

    Parameters
    ----------
    answers : CellAnswers
    files : callable
        Path of a file -> its name from that folder.
    """
    lines = ["# Answers of `servo-gateway cell new`; assumed values are comments."]
    for key, answer in answers.taken.items():
        value = _renamed(answer.value, files) if key in questions.FILES else answer.value
        if key in questions.FOR_ALL and all(part == value[0] for part in value):
            value = value[0]
        if key in answers.said:
            lines.append(f"{key} = {_written(value, answer.source)}")
        else:
            lines.append(f"# {key} = {toml_value(value)}   # {answer.source}")
    return "\n".join(lines) + "\n"


def _renamed(value: Any, files: Callable[[str], str]) -> Any:
    if isinstance(value, tuple):
        return tuple(_renamed(part, files) for part in cast("tuple[str, ...]", value))
    return value if value == DH or value in list_profiles() else files(value)


def _written(value: Any, source: str) -> str:
    text = toml_value(value)
    return text if source == UNSOURCED else f"{{ {VALUE} = {text}, {SOURCE} = {toml_value(source)} }}"


def toml_value(value: Any) -> str:
    """Return a value as TOML text; equal numbers of a list stay a list."""
    if value is None or value == ():
        return '"none"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, float | int):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        inside = ", ".join(f"{key} = {toml_value(part)}" for key, part in cast("Mapping[str, Any]", value).items())
        return f"{{ {inside} }}"
    return "[" + ", ".join(toml_value(part) for part in value) + "]"


#: A plausible axis, of a motor without a gear: it takes every torque constant of a motor.
_AXIS: Final[Mapping[str, Any]] = {
    "profile": "profile",
    "torque_constant_nm_per_a": {VALUE: 0.1, SOURCE: ASSUMED},
    "gear_ratio": {VALUE: 1, SOURCE: ASSUMED},
    "gear_efficiency": {VALUE: 1, SOURCE: ASSUMED},
    "position_limit_rad": (-1, 1),
    "speed_limit_rad_s": 1,
    "torque_limit_nm": 1,
}
#: Keys of answers that have another name in the cell file.
_RENAMED: Final = {questions.NODES.key: "node_id", questions.MOUNTING.key: "gravity_m_s2"}


def refusals(key: str, value: Any, ratio: Sequence[float], bounds: LoadBounds) -> list[str]:
    """Return what the model of the cell file refuses about an answer; empty if nothing.

    Parameters
    ----------
    key : str
        Key of the question.
    value
        Value in the format of the question.
    ratio : sequence of float
        Known gear ratios, for the check of a torque constant.
    bounds : LoadBounds
        Largest plausible load, if known.
    """
    if value is None or value == () or key == questions.BUS.key:
        return []
    wrong = bounds.violation(value, ()) if key in (questions.RATED_LOAD.key, questions.MAX_LOAD.key) else ""
    if wrong:
        return [f"{key}: {wrong}"]
    name = _RENAMED.get(key, key).removeprefix("dh_")
    per_axis = isinstance(value, tuple) and (name in AxisConfig.model_fields or name in DhTable.model_fields)
    axis = [{**_AXIS, "node_id": number + 1} for number in range(len(value) if per_axis else 1)]
    arm: dict[str, Any] = {"name": "main", "bus": "a", "robot": "arm.urdf", "gravity_m_s2": (0, 0, -9.80665)}
    arm["axis"] = axis
    bus: dict[str, Any] = {"interface": "virtual", "channel": "a"}
    cell: dict[str, Any] = {"name": "cell", "bus": {"a": bus}, "arm": [arm]}
    if name in AxisConfig.model_fields:
        for number, (row, part) in enumerate(zip(axis, value, strict=True)):
            if number < len(ratio):
                row["gear_ratio"] = {VALUE: ratio[number], SOURCE: ASSUMED}
            row[name] = _of_model(key, part)
    elif name in DhTable.model_fields:
        rows = dict.fromkeys(("alpha_rad", "a_m", "d_m", "theta_offset_rad"), (0.0,) * len(axis))
        arm |= {"robot": None, "dh": {"convention": "modified", **rows, name: value}}
    for model, table in ((BusConfig, bus), (Cell, cell), (ArmConfig, arm)):
        if name in model.model_fields:
            table[name] = _of_model(key, value)
            break
    try:
        fitted(Cell, cell)
    except Unfit as error:
        return list(dict.fromkeys(problem.what for problem in error.problems if name in problem.path))
    return []


def _of_model(key: str, value: Any) -> Any:
    """Return an answer as its field in the cell file has it."""
    number = int(value) if isinstance(value, float) and value.is_integer() else value
    return {VALUE: number, SOURCE: ASSUMED} if key in questions.SOURCED else number
