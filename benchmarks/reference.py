"""Tables of the reference pages that come from the code: keys, commands, drives, effects, thresholds, errors.

python -m benchmarks.reference [--write]: say which pages are not current, or bring them up to date.

A page is written by hand; its text between `<!-- NAME -->` and `<!-- /NAME -->` is `BLOCKS[NAME]`. Schemas are whole
files. The Python interface is written by mkdocstrings, from the docstrings.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from drives.draft.answers import ProfileAnswers
from drives.draft.questions import QUESTIONS
from drives.errors import DriveError
from drives.profile import DriveProfile
from drives.profile_file import list_profiles, load_profile
from gateway import api
from gateway.cell.axes import FEWEST_AXES, MOST_AXES
from gateway.cell.config import Cell
from gateway.cell.plausible import BOUNDS
from gateway.cli import main as program
from gateway.data.blackbox.part import FIELDS
from gateway.data.blackbox.ring_buffer import KEPT_S, MOST_BOXES
from gateway.data.csv_text import BLANK_ALLOWED, COLUMNS, PERIOD_COLUMNS
from gateway.data.period import KINDS, LEAST_PER_HARMONIC
from gateway.data.periods import CUTOFF_HZ
from gateway.data.recording.reader import SCHEMA, STATUSES
from gateway.data.recording.writer import VALUES, WORDS
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.errors import EXIT_CODES, GatewayError
from gateway.identify.rest.rest_thresholds import CONFLICT, REST_MODEL
from gateway.identify.tuned_number import described
from gateway.jobs.accept import accept
from gateway.jobs.calibrate import calibrate, store_calibration
from gateway.jobs.check import check, check_moving
from gateway.jobs.commission import commission
from gateway.jobs.configure import apply_files, compare_with_files, dump, restore
from gateway.jobs.drive_test import measure_timing
from gateway.jobs.follow import follow
from gateway.jobs.measure import move, record, record_until_known
from gateway.jobs.pair import learn, run_pair, teach
from gateway.jobs.replay import replay, store
from gateway.model.effect import Effect, nowhere
from gateway.model.effects import LIBRARY
from gateway.newcell.questions import ALL
from gateway.result.follow import FollowResult
from gateway.result.pair import LearnStatus, PairRunResult, StoredFunction, TaughtPathFile
from gateway.result.result import json_schema
from gateway.result.values import json_text, schema_of

REFERENCE: Final = Path(__file__).resolve().parents[1] / "docs" / "reference"
_BLOCK: Final = re.compile(r"(<!-- ([\w ]+) -->).*?(<!-- /\2 -->)", re.DOTALL)


def table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """Markdown table; `head` is its first line."""
    lines = (f"| {' | '.join(map(str, row))} |" for row in rows)
    return "\n".join(["\n", head, re.sub("[^|]+", "---", head), *lines, "\n"])


# ------------------------------------------------------------------------------------------------- keys of a TOML file


def keys(model: type[BaseModel]) -> str:
    """Every table of a TOML file with its keys; `model` is the whole file."""
    headers: dict[type[BaseModel], list[str]] = {}

    def walk(model: type[BaseModel], where: str) -> None:
        plain = where.replace("[]", "")
        headers.setdefault(model, []).append(f"[[{plain}]]" if where.endswith("[]") else f"[{plain}]")
        if len(headers[model]) == 1:
            for key, info in model.model_fields.items():
                for inner, many in _models_in(info.annotation):
                    walk(inner, f"{where}.{key}{many}".strip("."))

    walk(model, "")
    sections = []
    for each, names in ((each, list(dict.fromkeys(names))) for each, names in headers.items()):
        heading = "Top of the file" if each is model else f"`{names[0]}`" if len(names) == 1 else each.__name__
        several = f" In: {', '.join(f'`{name}`' for name in names)}." if len(names) > 1 else ""
        rows = (
            (f"`{key}`", info.description or "", kind_in_words(info.annotation), _absent(info))
            for key, info in each.model_fields.items()
        )
        summary = _summary(each) + several + table("| key | what it is | value | if absent |", rows)
        sections.append(f"\n\n## {heading}\n\n{summary.strip()}")
    return "".join(sections) + "\n\n"


def _models_in(kind: Any) -> Iterator[tuple[type[BaseModel], str]]:
    """Models inside a type, each with what its keys add to the header: `[]` in a list, `.NAME` in a mapping."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind, ""
        return
    origin = typing.get_origin(kind)
    suffix = "[]" if origin is tuple else ".NAME" if origin is dict else ""
    for argument in typing.get_args(kind):
        for model, inner in _models_in(argument):
            yield model, suffix + inner


def kind_in_words(kind: Any) -> str:
    """What a value of a TOML file has to be, from the type that its model states."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return kind_in_words(arguments[0])
    if origin is Literal:
        return " or ".join(f"`{each!r}`".replace("'", '"') for each in arguments)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(kind_in_words(each) for each in arguments if each is not type(None))
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return f"list: {kind_in_words(arguments[0])}"
        return f"{len(arguments)} x {kind_in_words(arguments[0])}"
    if origin is dict:
        return f"by name: {kind_in_words(arguments[1])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        fields = [key for key, info in kind.model_fields.items() if info.is_required()]
        return f"table ({', '.join(fields)})" if len(kind.model_fields) <= 3 else "table"
    return {int: "integer", float: "number", str: "text", bool: "true or false"}[kind]


def _absent(info: FieldInfo) -> str:
    if info.is_required():
        return "**refused**"
    default = info.get_default(call_default_factory=True) if info.default is PydanticUndefined else info.default
    if default is None or default == () or default == {} or isinstance(default, BaseModel):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{list(default) if isinstance(default, tuple) else default}`"


def _summary(documented: object) -> str:
    return " ".join((inspect.getdoc(documented) or "").split("\n\n")[0].split())


# -------------------------------------------------------------------------------------------------------------- others


def commands(command: click.Command = program, above: click.Context | None = None) -> str:
    """Help text of every command, as `-h` prints it."""
    name = "servo-gateway" if above is None else command.name
    context = click.Context(
        command, info_name=name, parent=above, **{**command.context_settings, "terminal_width": 100}
    )
    if isinstance(command, click.Group):
        inner = (command.get_command(context, name) for name in command.list_commands(context))
        return "".join(commands(each, context) for each in inner if each is not None and not each.hidden)
    heading = context.command_path.removeprefix("servo-gateway ")
    return f"\n\n## {heading}\n\n```\n{command.get_help(context)}\n```\n"


ARITHMETIC: Final = {
    "permille_rated_torque": "word / 1000 x rated torque",
    "permille_rated_current": "word / 1000 x rated current x Kt",
    "milliampere": "word / 1000 A x Kt",
    "internal_unit": "word x unit x Kt",
}


def _torque_word(profile: DriveProfile) -> str:
    """Return how the torque word of a profile becomes a torque: object, formula, rated value."""
    signal, words = profile.torque, list[str]()
    unit = "A" if signal.is_current else "Nm"
    if signal.rated is not None and signal.rated.object is not None:
        words.append(f"{_address(signal.rated.object)} x {signal.rated.unit:g} {unit}")
    elif signal.rated is not None:
        words.append(f"{signal.rated.value:g} {unit}")
    if signal.internal_unit_a is not None:
        words.append(f"{signal.internal_unit_a.value:.6g} A")
    if signal.is_current:
        words.append(signal.current_reference or "rms or peak is not known")
    return f"{_address(signal.object)}: {ARITHMETIC[signal.kind]}" + (f" ({', '.join(words)})" if words else "")


def _address(entry: Any) -> str:
    return f"0x{entry.index:04X}" + (f":{entry.subindex:02X}" if entry.subindex else "")


def _drives() -> str:
    simulated = json.loads((Path(__file__).parent / "makes.json").read_text(encoding="utf-8"))
    rows = (
        (
            f"`{each.name}`",
            each.description,
            _torque_word(each),
            each.torque.basis,
            ", ".join(_assumed(each.model_dump(exclude_none=True))),
            "both" if each.heartbeat.producer_ms else "of the master",
            "no" if each.obstacles else "yes",
            simulated.get(each.name, ""),
        )
        for each in map(load_profile, list_profiles())
    )
    return table(
        "| profile | drive | torque | source | not verified | heartbeat watched | moved | simulated make |", rows
    )


def _assumed(values: dict[str, Any], above: str = "") -> Iterator[str]:
    """Yield the keys of a profile whose source says that something in them is assumed."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _assumed(value, f"{above}{key}.")
        elif key == "source" and "assumed" in value:
            yield f"`{above.removesuffix('.')}`"


def _of_profiles(texts: Callable[[DriveProfile], Iterable[str]]) -> str:
    """A list of what is said of each profile."""
    profiles = map(load_profile, list_profiles())
    return "\n\n" + "".join(f"- `{each.name}`: {text}.\n" for each in profiles for text in texts(each)) + "\n"


def _profile_answers() -> str:
    fields = ProfileAnswers.model_fields.items()
    rows = ((f"`{key}`", info.description, kind_in_words(info.annotation)) for key, info in fields)
    questions = (
        f"## `{each.key}`\n\n{each.asks}\n\n" + "".join(f"- {method}\n" for method in each.ways) for each in QUESTIONS
    )
    return table("| key | answer | value |", rows) + "\n".join(questions) + "\n"


def _effects() -> str:
    rows = (
        (f"`{each.name}`", each.meaning, _detected(each), ", ".join(f"`{key}`" for key in each.parameters))
        for each in LIBRARY.values()
    )
    return table("| effect | what it is | found | parameters, by shape |", rows)


def _detected(effect: Effect) -> str:
    if effect.mistake is not None:
        return "commissioning mistake: a failing finding"
    faces = [("at rest", effect.at_rest), ("in motion", effect.in_motion)]
    return ", ".join(words for words, face in faces if face is not nowhere) or "by sides of visits"


def _columns() -> str:
    rows = []
    for column in (*COLUMNS, *PERIOD_COLUMNS):
        first, last = column.name.format(1), column.name.format("N")
        blank = "yes" if first in BLANK_ALLOWED else "no"
        name = f"`{first}`" if first == last else f"`{first}` .. `{last}`"
        rows.append((name, column.unit, column.needed, blank, column.meaning.format("1")))
    rows.append(("`x_...`", "", "no", "no", "anything else, such as the lever column of `--method coefficient`"))
    return table("| column | unit | needed | may be empty | meaning |", rows)


def _exit_codes() -> str:
    errors: dict[int, list[str]] = {code: [] for code in EXIT_CODES}
    waiting: list[type[Exception]] = [GatewayError, DriveError]
    for error in waiting:
        errors.setdefault(getattr(error, "exit_code", 1), []).append(f"`{error.__name__}`")
        waiting += [each for each in error.__subclasses__() if each.__module__ in ("gateway.errors", "drives.errors")]
    rows = ((code, when, ", ".join(sorted(errors[code]))) for code, when in EXIT_CODES.items())
    return table("| exit code | when | errors |", rows)


def _numbers(rows: Iterable[Iterable[object]]) -> str:
    return table("| name | value | unit | what it is | origin |", rows)


def _thresholds(of: Any) -> str:
    return _numbers((f"`{name}`", *row) for name, *row in described(of))


#: Public functions for programs that measure.
JOBS: Final = (
    *(check, check_moving, move, record, record_until_known, commission, accept, follow, teach),
    *(run_pair, learn, calibrate, store_calibration, measure_timing, dump, compare_with_files, apply_files, restore),
    *(store, replay),
)
BLOCKS: Final[Mapping[str, Callable[[], str]]] = {
    "keys of a cell file": lambda: keys(Cell),
    "plausible values": lambda: _numbers((name, f"{value:.6g}", *about) for name, (value, *about) in BOUNDS.items()),
    "keys of a drive profile": lambda: keys(DriveProfile),
    "drives": _drives,
    "drives not moved": lambda: _of_profiles(lambda profile: profile.obstacles),
    "sources of profiles": lambda: _of_profiles(lambda profile: [profile.source]),
    "answers of a profile": _profile_answers,
    "answers of a cell": lambda: table(
        "| key | answer | how to find out |", ((f"`{each.key}`", each.asks, each.ways[0]) for each in ALL)
    ),
    "commands": lambda: commands() + "\n",
    "public names": lambda: table(
        "| name | what it is |", ((f"`{name}`", _summary(getattr(api, name))) for name in api.__all__)
    ),
    "jobs": lambda: table(
        "| function | what it does |", ((f"`{each.__module__}.{each.__name__}`", _summary(each)) for each in JOBS)
    ),
    "effects": _effects,
    "model at rest": lambda: _thresholds(REST_MODEL),
    "statements": lambda: _thresholds(CONFLICT),
    "diagnosis at rest": lambda: _thresholds(REST),
    "diagnosis in motion": lambda: _thresholds(MOVING),
    "exit codes": _exit_codes,
    "columns": _columns,
    "axes": lambda: f"{FEWEST_AXES} to {MOST_AXES}",
    "datasets": lambda: table(
        "| dataset | unit |", ((f"`{key}`", unit) for key, (_, unit) in (WORDS | VALUES).items())
    ),
    "schema": lambda: str(SCHEMA),
    "statuses": lambda: ", ".join(f"`{each}`" for each in STATUSES),
    "kinds": lambda: ", ".join(KINDS),
    "least": lambda: str(LEAST_PER_HARMONIC),
    "cutoff": lambda: f"{CUTOFF_HZ:g} Hz",
    "kept": lambda: f"{KEPT_S:g} s",
    "boxes": lambda: str(MOST_BOXES),
    "fields": lambda: ", ".join(f"`{name}`" for name, _ in FIELDS),
}
#: Schemas of the files that leave.
SCHEMAS: Final[Mapping[str, Callable[[], dict[str, Any]]]] = {
    "result": json_schema,
    "follow": lambda: schema_of(FollowResult),
    "pair-run": lambda: schema_of(PairRunResult),
    "pair-points": lambda: schema_of(TaughtPathFile),
    "pair-function": lambda: schema_of(StoredFunction),
    "pair-learn": lambda: schema_of(LearnStatus),
}


def stale(reference: Path = REFERENCE) -> dict[Path, str]:
    """Pages that are not what the code says, each with the text that it should have."""
    pages = {path: path.read_text(encoding="utf-8") for path in sorted(reference.glob("*.md"))}
    current = {
        path: _BLOCK.sub(lambda block: block[1] + BLOCKS[block[2]]() + block[3], text) for path, text in pages.items()
    } | {reference / f"{name}.schema.json": json_text(schema()) for name, schema in SCHEMAS.items()}
    return {
        path: text for path, text in current.items() if not path.exists() or path.read_text(encoding="utf-8") != text
    }


def main(argv: list[str]) -> int:
    """Exit 1 when a page is not current and was not written."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reference", description=__doc__)
    parser.add_argument("--write", action="store_true", help="bring the pages up to date")
    arguments = parser.parse_args(argv)
    old = stale()
    for path, text in old.items():
        if arguments.write:
            path.write_text(text, encoding="utf-8")
        print(f"{'written' if arguments.write else 'not current'}: docs/reference/{path.name}")
    return 1 if old and not arguments.write else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
