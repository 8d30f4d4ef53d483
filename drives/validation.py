"""Validate TOML files with pydantic; report every problem of a file.

A problem names its line, its key and the remedy. All problems of a file are reported at once: an invalid value is
replaced temporarily by a valid one, so that the checks of whole tables still run.
"""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from drives.toml_lines import KeyPath, key_lines, line_of
from drives.toml_problems import field_at, placeholder, problem_text
from drives.toml_text import parse_toml

#: Times that what was found is replaced to find more.
_ROUNDS: Final = 4
#: Lines of a message.
_MOST_LINES: Final = 10

Model = TypeVar("Model", bound=BaseModel)


class Strict(BaseModel):
    """Base model of a TOML table: frozen, without unknown keys, all numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Refused(ValueError):  # noqa: N818 - reads as what a validator does
    """Problems that the validator of a table has found.

    Parameters
    ----------
    found : (path, str) pairs
        Key, from that table on, and what is wrong with it and what to write.
    """

    def __init__(self, *found: tuple[KeyPath, str]) -> None:
        self.found = found
        super().__init__("; ".join(what for _, what in found))


def refuse(found: Sequence[tuple[KeyPath, str]]) -> None:
    """Raise the problems if there are any."""
    if found:
        raise Refused(*found)


@dataclass(frozen=True, slots=True)
class FileProblem:
    """One problem of a file; `line` counts from 1, 0 = no line; `what` includes the remedy."""

    path: KeyPath
    line: int
    what: str


class Unfit(ValueError):  # noqa: N818 - reads as what the file is
    """A file is not valid; holds all problems in the order of their lines."""

    def __init__(self, problems: Sequence[FileProblem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        super().__init__("; ".join(f"line {problem.line}: {problem.what}" for problem in self.problems))

    def messages(self, where: str, place: Callable[[KeyPath], str] = lambda path: "") -> tuple[str, ...]:
        """A line of text per problem, ten at most: `cell.toml line 31, J1: what`; the last holds what is left.

        Parameters
        ----------
        where : str
            The file.
        place : callable
            What a reader calls the table of a path, such as J1; empty where the line says it all.
        """
        same: dict[str, list[FileProblem]] = {}
        for problem in self.problems:
            same.setdefault(problem.what, []).append(problem)
        texts = []
        for what, problems in same.items():
            lines = list(dict.fromkeys(str(problem.line) for problem in problems if problem.line))
            places = list(dict.fromkeys(name for problem in problems if (name := place(problem.path))))
            at = [f"line{'s' if len(lines) > 1 else ''} {', '.join(lines)}"] if lines else []
            texts.append(f"{' '.join([where, ', '.join([*at, *places])]).strip()}: {what}")
        if len(texts) > _MOST_LINES:
            texts[_MOST_LINES - 1 :] = ["; ".join(texts[_MOST_LINES - 1 :])]
        return tuple(texts)


def read_strict(text: str, model: type[Model]) -> Model:
    """Parse and validate a TOML text against a model.

    Raises
    ------
    Unfit
        With every problem of the file.
    """
    try:
        data = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise not_toml(text, error) from error
    try:
        return _validated(model, data)
    except ValidationError as error:
        lines = key_lines(text)
        problems = [FileProblem(path, line_of(lines, path), what) for path, what in _all(model, data, error)]
        raise Unfit(problems) from error


def fitted(model: type[Model], values: dict[str, Any]) -> Model:
    """Validate a table of typed-in values; numbers may be given as text.

    Raises
    ------
    Unfit
        With every problem, none of which has a line.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise Unfit([FileProblem(path, 0, what) for path, what in _problems(model, values, error)]) from error


def _validated(model: type[Model], data: dict[str, Any]) -> Model:
    """Validate as JSON, which accepts a list for a tuple but no text or boolean for a number."""
    return model.model_validate_json(json.dumps(data, default=str), strict=True)


def not_toml(text: str, error: tomllib.TOMLDecodeError) -> Unfit:
    """Return the problem of a text that is not TOML, with the line from the parser's message."""
    message = str(error)
    what, _, at = message.rpartition(" (at ")
    number = at.removeprefix("line ").partition(",")[0]
    line = int(number) if number.isdigit() else max(1, len(text.splitlines()))
    wrong = f"not valid TOML: {what or message}; correct that line (KEY = VALUE, texts in quotes)"
    return Unfit([FileProblem((), line, wrong)])


def _all(model: type[BaseModel], data: dict[str, Any], error: ValidationError) -> list[tuple[KeyPath, str]]:
    mended = copy.deepcopy(data)
    found: dict[tuple[KeyPath, str], None] = {}
    touched: set[KeyPath] = set()
    for _ in range(_ROUNDS):
        new = [each for each in _problems(model, data, error) if each not in found and not _follows(each[0], touched)]
        if not new:
            break
        found |= dict.fromkeys(new)
        touched |= {path for path, _ in new}
        for path, _ in new:
            _mend(model, mended, path)
        try:
            _validated(model, mended)
        except ValidationError as again:
            error = again
        else:
            break
    return list(found)


def _follows(path: KeyPath, touched: set[KeyPath]) -> bool:
    """Return whether a problem may be caused by an inserted dummy value."""
    return any(path[: len(each)] == each or each[: len(path)] == path for each in touched)


def _problems(model: type[BaseModel], data: dict[str, Any], error: ValidationError) -> Iterator[tuple[KeyPath, str]]:
    """Return path and text of each problem; for a union, only the problem of the best matching member."""
    seen: set[KeyPath] = set()
    for detail in sorted(error.errors(include_url=False), key=lambda each: -len(each["loc"])):
        cause = detail.get("ctx", {}).get("error")
        if isinstance(cause, Refused):
            seen.add(tuple(detail["loc"]))
            yield from (((*detail["loc"], *path), what) for path, what in cause.found)
            continue
        path = field_at(model, detail["loc"]).path
        if detail["type"] == "extra_forbidden":
            path = detail["loc"]
        # elements that are wrong are not counted as there
        among_others = detail["type"] == "too_short" and any(each[: len(path)] == path for each in seen)
        if path not in seen and not among_others:
            seen.add(path)
            yield path, problem_text(model, data, path, detail)


def _mend(model: type[BaseModel], data: dict[str, Any], path: KeyPath) -> None:
    """Remove optional values, insert a valid one where a value is required."""
    table: Any = data
    try:
        for part in path[:-1]:
            table = table[part]
    except (KeyError, IndexError, TypeError):
        return
    last: Any = path[-1] if path else None
    place = field_at(model, path)
    if isinstance(table, list) and isinstance(last, int):
        if last < len(table):
            table[last] = placeholder(place.kind, place.info)
        else:
            _mend(model, data, path[:-1])
    elif isinstance(table, dict) and isinstance(last, str):
        if place.path == path and (place.info is None or place.info.is_required()):
            table[last] = placeholder(place.kind, place.info)
        else:
            table.pop(last, None)
