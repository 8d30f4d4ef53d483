"""Pages of the reference that the code itself can write: keys of cell file and drive profile, commands, result.

python -m benchmarks.reference [--write]: say which pages are not current, or bring them up to date.
"""

from __future__ import annotations

import argparse
import sys
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from benchmarks.reference_api import api_page
from benchmarks.reference_drives import answers_page, drives_page
from benchmarks.reference_files import exit_codes_page, recording_page, table_page
from benchmarks.reference_newcell import cell_answers_page
from benchmarks.toml_words import kind_in_words
from drives.profile import DriveProfile
from gateway.cell.config import Cell
from gateway.cell.plausible import BOUNDS
from gateway.cli import main as program
from gateway.diagnose.moving.moving_diagnosis_thresholds import MOVING
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.identify.rest.rest_thresholds import CONFLICT, REST_MODEL
from gateway.identify.tuned_number import described
from gateway.model.effect import Effect, nowhere
from gateway.model.effects import LIBRARY
from gateway.result.follow import FollowResult
from gateway.result.pair import LearnStatus, PairRunResult, StoredFunction, TaughtPathFile
from gateway.result.result import json_schema
from gateway.result.values import json_text, schema_of

DOCS: Final = Path(__file__).resolve().parents[1] / "docs"


# ------------------------------------------------------------------------------------------------- keys of a TOML file


def keys_page(title: str, intro: str, model: type[BaseModel]) -> str:
    """Every table of a file with its keys.

    Parameters
    ----------
    title, intro : str
    model : type
        The whole file.
    """
    lines = [f"# {title}", "", intro]
    for names, table in tables_of(model):
        heading = "Top of the file" if table is model else f"`{names[0]}`" if len(names) == 1 else table.__name__
        several = f" In: {', '.join(f'`{name}`' for name in names)}." if len(names) > 1 else ""
        lines += ["", f"## {heading}", "", _first_line(table) + several, ""]
        lines += ["| key | what it is | value | if absent |", "|---|---|---|---|"]
        for key, info in table.model_fields.items():
            lines.append(f"| `{key}` | {info.description or ''} | {kind_in_words(info.annotation)} | {_absent(info)} |")
    return "\n".join(lines) + "\n"


def tables_of(model: type[BaseModel]) -> list[tuple[tuple[str, ...], type[BaseModel]]]:
    """The model and every table inside it, with the headers that TOML gives it."""
    found: dict[type[BaseModel], list[str]] = {}

    def walk(table: type[BaseModel], where: str) -> None:
        known = table in found
        found.setdefault(table, []).append(_header(where))
        if known:
            return
        for key, info in table.model_fields.items():
            for inner, many in _models_in(info.annotation):
                walk(inner, f"{where}.{key}{many}" if where else f"{key}{many}")

    walk(model, "")
    return [(tuple(dict.fromkeys(names)), table) for table, names in found.items()]


def _header(where: str) -> str:
    many = where.endswith("[]")
    plain = where.replace("[]", "")
    return f"[[{plain}]]" if many else f"[{plain}]"


def _models_in(kind: Any) -> Iterator[tuple[type[BaseModel], str]]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind, ""
        return
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    suffix = "[]" if origin is tuple else ".NAME" if origin is dict else ""
    for argument in arguments:
        for model, inner in _models_in(argument):
            yield model, suffix + inner


def _absent(info: FieldInfo) -> str:
    if info.is_required():
        return "**refused**"
    default = info.get_default(call_default_factory=True) if info.default is PydanticUndefined else info.default
    if default is None or default == () or default == {} or isinstance(default, BaseModel):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{list(default) if isinstance(default, tuple) else default}`"


def _first_line(table: type[BaseModel]) -> str:
    return " ".join((table.__doc__ or "").strip().split("\n\n")[0].split())


# ------------------------------------------------------------------------------------------------------------ commands


def commands_page() -> str:
    """Every command with its arguments and options."""
    lines = ["# Commands", "", "`servo-gateway COMMAND -h` prints the same. `-v` and `-q` go with every command."]
    for name, command in _commands(typing.cast(click.Group, program), ()):
        usage = " ".join(part for part in (f"servo-gateway {name}", *_metavars(command)) if part)
        lines += ["", f"## {name}", "", _help_of(command), "", "```", usage, "```"]
        options = [each for each in command.params if isinstance(each, click.Option) and each.name not in COMMON]
        if options:
            lines += ["", "| option | what it does |", "|---|---|"]
            lines += [f"| `{_cell(_option(each))}` | {_cell(each.help or '')} |" for each in options]
    return "\n".join(lines) + "\n"


#: Options that go with every command.
COMMON: Final = frozenset({"verbose", "quiet", "help"})


def _commands(group: click.Group, above: tuple[str, ...]) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group, info_name="servo-gateway")
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from _commands(command, (*above, name))
        elif command is not None and not command.hidden:
            yield " ".join((*above, name)), command


def _help_of(command: click.Command) -> str:
    return " ".join((command.help or "").replace("\b", "").split())


def _metavars(command: click.Command) -> list[str]:
    context = click.Context(command)
    return [each.make_metavar(context) for each in command.params if isinstance(each, click.Argument)] + ["[OPTIONS]"]


def _option(option: click.Option) -> str:
    names = " / ".join([*option.opts, *option.secondary_opts])
    if option.is_flag:
        return names
    return f"{names} {option.make_metavar(click.Context(click.Command('x')))}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


# ------------------------------------------------------------------------------------------------------------- effects


def effects_page() -> str:
    """Every effect of the diagnosis."""
    lines = [
        "# Effects",
        "",
        "One file each in `gateway/model/effects/`. The key of a parameter ends with its unit; the",
    ]
    lines += [
        "result also has its standard deviation. See [how a cause is found](../explanation/how-a-cause-is-found.md).",
        "",
    ]
    lines += ["| effect | what it is | found | parameters, by shape |", "|---|---|---|---|"]
    for effect in LIBRARY.values():
        keys = ", ".join(f"`{key}`" for key in effect.parameters)
        lines.append(f"| `{effect.name}` | {effect.meaning} | {_found(effect)} | {keys} |")
    return "\n".join(lines) + "\n"


def _found(effect: Effect) -> str:
    if effect.mistake is not None:
        return "commissioning mistake: a failing finding"
    faces = [("at rest", effect.at_rest), ("in motion", effect.in_motion)]
    return ", ".join(words for words, face in faces if face is not nowhere) or "by sides of visits"


# ---------------------------------------------------------------------------------------------------------- thresholds


def _numbers(title: str, rows: Iterable[Iterable[object]]) -> list[str]:
    """A table of numbers with unit, meaning and origin."""
    head = ["", f"## {title}", "", "| name | value | unit | what it is | origin |", "|---|---|---|---|---|"]
    return head + [f"| {' | '.join(map(str, row))} |" for row in rows]


def cell_page() -> str:
    """Keys of a cell file, and the bounds of its values."""
    intro = (
        "TOML. A key that is not in this list is refused, and so is a constant without its source. `examples/` holds"
        " three complete files; how motor and joint belong together: `gateway/cell/conversion.py`. A value beyond the"
        " largest plausible one, in the last table, is refused."
    )
    rows = [(name, f"{value:.6g}", *about) for name, (value, *about) in BOUNDS.items()]
    return keys_page("Cell file", intro, Cell) + "\n".join([*_numbers("Largest plausible values", rows), ""])


def thresholds_page() -> str:
    """Every tuned number of the diagnosis."""
    intro = "Every tuned number, its unit, what it decides and where its value comes from."
    lines = ["# Thresholds of the diagnosis", "", intro]
    for title, thresholds in (
        ("Model at rest", REST_MODEL),
        ("Statements", CONFLICT),
        ("At rest", REST),
        ("In motion", MOVING),
    ):
        lines += _numbers(title, ((f"`{name}`", *row) for name, *row in described(thresholds)))
    return "\n".join(lines) + "\n"


#: Files beside the result that leave, by the name of their schema.
FILES: Final[Mapping[str, type]] = {
    "follow": FollowResult,
    "pair-run": PairRunResult,
    "pair-points": TaughtPathFile,
    "pair-function": StoredFunction,
    "pair-learn": LearnStatus,
}


def _schema(model: type) -> str:
    return json_text(schema_of(model))


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "reference/cell-file.md": cell_page,
    "reference/drive-profile.md": lambda: keys_page(
        "Drive profile",
        "TOML, one file a drive model. How to write one: [drive models](../how-to/drive-profiles.md).",
        DriveProfile,
    ),
    "reference/drives.md": drives_page,
    "reference/profile-answers.md": answers_page,
    "reference/cell-answers.md": cell_answers_page,
    "reference/commands.md": commands_page,
    "reference/python.md": api_page,
    "reference/measured-table.md": table_page,
    "reference/recording.md": recording_page,
    "reference/exit-codes.md": exit_codes_page,
    "reference/effects.md": effects_page,
    "reference/thresholds.md": thresholds_page,
    "reference/result.schema.json": lambda: json_text(json_schema()),
    **{f"reference/{name}.schema.json": partial(_schema, model) for name, model in FILES.items()},
}


def stale(docs: Path = DOCS) -> list[str]:
    """Pages that are not what the code says."""
    return [name for name, page in PAGES.items() if _text(docs / name) != page()]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.exists() else ""


def main(argv: list[str]) -> int:
    """Exit 1 when a page is not current and was not written."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reference", description=__doc__)
    parser.add_argument("--write", action="store_true", help="bring the pages up to date")
    arguments = parser.parse_args(argv)
    old = stale()
    for name in old:
        if arguments.write:
            (DOCS / name).write_text(PAGES[name](), encoding="utf-8")
        print(f"{'written' if arguments.write else 'not current'}: docs/{name}")
    return 1 if old and not arguments.write else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
