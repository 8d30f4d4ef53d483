"""Answers of options, of an answer file, of a person: who gave which, what was offered instead, what is missing.

An answer file is TOML: one key a question (`questions.ALL`), a value for all axes or a list, and where a constant comes
from as `{ value = 101, source = "data sheet p. 4" }`.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from drives.errors import ProfileError
from drives.profile_file import find_profile, list_profiles
from drives.profile_parts import is_assumed
from drives.toml_lines import key_lines
from drives.toml_text import parse_toml, toml_string
from drives.validation import not_toml
from gateway.errors import ConfigError
from gateway.model.load_bounds import NO_ARM
from gateway.newcell import questions
from gateway.newcell.forms import SOURCE, VALUE
from gateway.newcell.questions import CellQuestion
from gateway.newcell.unit_mistakes import slips

ASSUMED: Final = "assumed"
#: In the place of a URDF: the arm is described by Denavit-Hartenberg rows.
DH: Final = "dh"
UNSOURCED: Final = "stated, source not given"


@dataclass(frozen=True, slots=True)
class Answer:
    """A value in the form of its question, and where it comes from; a source that begins with `assumed` is a guess."""

    value: Any
    source: str

    @property
    def guessed(self) -> bool:
        """Nobody said so, and nothing was read."""
        return is_assumed(self.source)


@dataclass(frozen=True, slots=True)
class GivenAnswer:
    """An answer as it was written: value of TOML, where it stands, and the folder its file names start at."""

    value: Any
    where: str
    folder: Path


@dataclass(frozen=True, slots=True)
class OpenQuestion:
    """A question as a person sees it.

    Attributes
    ----------
    question : CellQuestion
    offer : Answer or None
        What is taken where the person types nothing.
    number, most : int
        Which question this is, and how many there are at most: what is read or offered is not asked.
    read : callable
        Value of TOML as typed -> the answer; raises ValueError in words.
    """

    question: CellQuestion
    offer: Answer | None
    number: int
    most: int
    read: Callable[[Any], Answer]


#: Asks a person: what was typed, None = the offer is taken.
Ask = Callable[[OpenQuestion], Answer | None]


class CellAnswers:
    """Everything that was answered so far.

    Parameters
    ----------
    given : mapping
        Key -> what options and answer file say.
    missing_in : str
        Where an answer that nobody gave has to be written.
    ask : callable, optional
        Asks a person for what was not given; None = nobody is asked, offers are taken.
    resumed : mapping
        Key -> answers that were kept when an earlier run ended early; one that does not hold any more is asked again.

    Attributes
    ----------
    taken : dict
        Key -> the answer, offers included, in the order of the questions.
    said : dict
        Key -> the answers among them that somebody gave.
    bounds : LoadBounds
        What stated loads are held against.
    typed : int
        Answers that a person typed in this run.
    """

    def __init__(
        self,
        given: Mapping[str, GivenAnswer],
        missing_in: str,
        ask: Ask | None = None,
        resumed: Mapping[str, GivenAnswer] | None = None,
    ) -> None:
        self._given, self._missing_in, self._ask = dict(given), missing_in, ask
        self._resumed = dict(resumed or {})
        self._asked = self.typed = 0
        self.taken: dict[str, Answer] = {}
        self.said: dict[str, Answer] = {}
        self.bounds = NO_ARM

    def settle(self, wanted: Sequence[tuple[CellQuestion, Answer | None]], axes: int = 0) -> None:
        """Settle some questions, each with what is offered where nobody answers.

        Raises
        ------
        ConfigError
            Answers that have not the right form, or are missing; all of them at once.
        """
        problems: list[str] = []
        for question, offer in wanted:
            try:
                answer = self._answer(question, offer, axes)
            except ValueError as error:
                problems.append(str(error))
                continue
            if answer is None:
                problems.append(f"{self._missing_in}: {question.key} is missing: {question.asks} ({question.how})")
                continue
            self.taken[question.key] = answer
        if problems:
            raise ConfigError.of(problems)

    def value(self, question: CellQuestion) -> Any:
        """Value of a question that was settled."""
        return self.taken[question.key].value

    def _answer(self, question: CellQuestion, offer: Answer | None, axes: int) -> Answer | None:
        given = self._given.get(question.key)
        if given is not None:
            answer = self._read(question, given, axes)
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

    def _kept(self, question: CellQuestion, axes: int) -> Answer | None:
        """The answer of an earlier run, where it still holds."""
        kept = self._resumed.get(question.key)
        try:
            return None if kept is None else self._verified(question, kept, axes)
        except ValueError:
            return None

    def _person(self, ask: Ask, question: CellQuestion, offer: Answer | None, axes: int) -> Answer | None:
        """Ask at the terminal; the answer is held against files and profiles at once."""
        here = Path.cwd()
        self._asked += 1
        done = {*self.taken, *self._given, *(each.key for each in questions.UNASKED), question.key}
        rows = () if self.taken.get(questions.ROBOT.key, Answer("", "")).value == DH else questions.DH_KEYS
        left = [key for key in questions.KEYS if key not in done and key not in rows]

        def read(value: Any) -> Answer:
            return self._verified(question, GivenAnswer(value, "", here), axes)

        answer = ask(OpenQuestion(question, offer, self._asked, self._asked + len(left), read))
        self.typed += answer is not None
        return answer

    def _verified(self, question: CellQuestion, given: GivenAnswer, axes: int) -> Answer:
        """Read an answer whose files are there and can be read; names of profiles are completed.

        Raises
        ------
        ValueError
            In words.
        """
        answer = self._read(question, given, axes)
        try:
            if question is questions.PROFILE:
                names = tuple(completed_profile(name) for name in answer.value)
                for name in set(names):
                    find_profile(name, given.folder)
                return Answer(names, answer.source)
        except ProfileError as error:
            raise ValueError(f"{question.key}: {error}") from error
        if question is questions.ROBOT and answer.value != DH and not Path(answer.value).is_file():
            raise ValueError(f"{question.key}: there is no file {answer.value}")
        return answer

    def _read(self, question: CellQuestion, given: GivenAnswer, axes: int) -> Answer:
        value, source = given.value, UNSOURCED
        if isinstance(value, dict) and set(cast("dict[str, Any]", value)) == {VALUE, SOURCE}:
            value, source = value[VALUE], str(cast("dict[str, Any]", value)[SOURCE])
        try:
            answer = question.form.read(value, axes)
        except ValueError as error:
            where = f"{given.where}: " if given.where else ""
            raise ValueError(f"{where}{question.key} {error}: {question.asks}") from error
        gears = self.taken.get(questions.GEAR_RATIO.key)
        for slip in slips(question.key, answer, gears.value if gears is not None else (), self.bounds):
            raise ValueError(f"{given.where}: {slip}" if given.where else slip)
        if question.key in questions.FILES:
            answer = _placed(answer, given.folder)
        return Answer(answer, source)


def _placed(value: Any, folder: Path) -> Any:
    """Names of files from the folder that they were written in; names of profiles and `dh` stay."""
    if isinstance(value, tuple):
        return tuple(_placed(part, folder) for part in cast("tuple[str, ...]", value))
    return value if value == DH or value in list_profiles() else str(folder / value)


def completed_profile(name: str) -> str:
    """The profile of the package that a path or a beginning stands for; any other name as it is.

    Raises
    ------
    ValueError
        A file that is not there: says which profiles are alike.
    """
    stem, known = Path(name).name, list_profiles()
    if name in known or Path(name).is_file() or Path(f"{name}.toml").is_file():
        return name
    begun = [each for each in known if each.startswith(stem)]
    if len(begun) == 1:
        return begun[0]
    near = begun or difflib.get_close_matches(stem, known, 3, 0.5)
    said = f"did you mean {' or '.join(near)}?" if near else f"the package has {', '.join(known)}"
    raise ValueError(f"profile: '{stem}' is neither a profile of the package nor a file; {said}")


def read_answers(path: Path) -> dict[str, GivenAnswer]:
    """Answers of a file.

    Raises
    ------
    ConfigError
        It cannot be read, is no TOML, or has keys that no question has; all of them at once.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}; give an answer file") from error
    try:
        table = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError.of(not_toml(text, error).messages(str(path))) from error
    known = questions.KEYS
    lines = key_lines(text)
    strange = [f"{path} line {lines[key,]}: {key} answers no question" for key in table if key not in known]
    if strange:
        strange[-1] += f"; the questions are {', '.join(known)}"
        raise ConfigError.of(strange)
    folder = path.resolve().parent
    return {key: GivenAnswer(value, f"{path} line {lines[key,]}", folder) for key, value in table.items()}


def answers_text(answers: CellAnswers, files: Callable[[str], str]) -> str:
    """The answers of a run as answer file: what was said as it stands, what was taken unsaid as a remark.

    Parameters
    ----------
    answers : CellAnswers
    files : callable
        Path of a file -> its name from that folder.
    """
    lines = ["# Answers of `servo-gateway cell new`; what nobody answered is a remark."]
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
    """A value as TOML writes it; equal numbers of a list stay a list."""
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
