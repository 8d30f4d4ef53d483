"""Options that several commands share."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from drives.files import replace_file
from gateway.commands.console import Session

if TYPE_CHECKING:
    from gateway.result.acceptance import Expected

Function = TypeVar("Function", bound=Callable[..., Any])


def session_of(ctx: click.Context | None = None) -> Session:
    """The session of the running command line."""
    context = ctx if ctx is not None else click.get_current_context()
    return context.ensure_object(Session)


def _louder(ctx: click.Context, _param: click.Parameter, value: int) -> None:
    session_of(ctx).verbosity += value


def _quieter(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if value:
        session_of(ctx).verbosity = -1


def common(function: Function) -> Function:
    """Add -v and -q."""
    function = click.option(
        "-v", "--verbose", count=True, expose_value=False, callback=_louder, help="Say more; twice for every detail."
    )(function)
    return click.option("-q", "--quiet", is_flag=True, expose_value=False, callback=_quieter, help="Errors only.")(
        function
    )


def _json_target(ctx: click.Context, _param: click.Parameter, value: str | None) -> str | None:
    if value == "-":
        session_of(ctx).data_on_stdout = True
    return value


json_option = click.option(
    "--json", "json_out", metavar="OUT", callback=_json_target, help="Write the result as JSON; - for stdout."
)


operator_option = click.option("--operator", metavar="NAME", help="Who measures: stands in the report, to be signed.")


def _expected(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> tuple[Expected, ...]:
    from gateway.result.acceptance import parse_expected

    return tuple(parse_expected(text) for text in value)


def accept_options(function: Function) -> Function:
    """Add the options of ACCEPT."""
    function = click.option(
        "--junit",
        "junit_file",
        metavar="FILE",
        type=click.Path(path_type=Path, dir_okay=False),
        help="Write pass and fail as JUnit XML.",
    )(function)
    return click.option(
        "--expect",
        "expected",
        multiple=True,
        metavar="LABEL=MASS,TOLERANCE",
        callback=_expected,
        help="What a load weighs, and how far it may be off: kg; repeatable. Pass, fail or cannot tell.",
    )(function)


bus_option = click.option(
    "--bus",
    "bus_spec",
    metavar="SPEC",
    help="Bus to use instead of the cell file's; NAME=SPEC;NAME=SPEC for a cell with several.",
)
cell_argument = click.argument("cell", type=click.Path(path_type=Path, dir_okay=False))


def model_options(function: Function) -> Function:
    """Add the options of MODEL."""
    for option in (
        click.option(
            "--torque-gain",
            metavar="exact|prior:S",
            help="How far the torque constants are trusted; the cell's std_percent if omitted, prior:0.03 for tables.",
        ),
        click.option("--bare", type=click.Path(path_type=Path, dir_okay=False), help="Stored bare identification."),
        click.option(
            "--known",
            multiple=True,
            metavar="LABEL=MASS,X,Y,Z",
            help="A load that is known: kg and m in link_6 (the last link).",
        ),
        click.option(
            "--inertials", metavar="exact|prior:S|ignore", help="How far the URDF's link inertials are trusted."
        ),
        click.option("--cell", "cell_file", type=click.Path(path_type=Path, dir_okay=False), help="Cell file."),
        click.option("--robot", type=click.Path(path_type=Path, dir_okay=False), help="Robot as URDF."),
    ):
        function = option(function)
    return function


data_argument = click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path, dir_okay=False))


def write_json(target: str, payload: Mapping[str, Any]) -> None:
    """Write JSON to a file (replaced whole) or, for `-`, to stdout; a NaN is a defect and raises."""
    text = json.dumps(payload, indent=1, allow_nan=False) + "\n"
    if target == "-":
        click.echo(text, nl=False)
    else:
        replace_file(Path(target), text)


def confirm(question: str, *, yes: bool) -> None:
    """Ask before anything moves; no answer means no."""
    if not yes:
        click.confirm(question, abort=True, err=True)


def one_of(names: Sequence[str]) -> click.Choice[str]:
    """A choice among names, spelled exactly."""
    return click.Choice(list(names))
