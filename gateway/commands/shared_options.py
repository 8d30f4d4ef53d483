"""Options that several commands share."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from drives.files import replace_file
from gateway.cell.plausible import LARGEST_ANGLE_RAD
from gateway.commands.console import Session
from gateway.data.labels import label_refused
from gateway.errors import InputError

if TYPE_CHECKING:
    from drives.datasheet.sheet import Remark
    from gateway.model.robot import Robot
    from gateway.result.acceptance import Expected

#: Lines of a data sheet that are named unasked.
REMARKS_SHOWN = 10

KNOWN_FORM = "LABEL=MASS[,[FRAME=]X,Y,Z]"
KNOWN_HELP = (
    "kg and m; FRAME: flange, or link_6 (the last link), which is taken where none is named. Without X,Y,Z the centre"
    " is estimated."
)

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


def _forced(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    session_of(ctx).replaces = value


def new_file(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """A file to write: one that is there is not replaced unasked.

    Raises
    ------
    InputError
    """
    if value is not None:
        refuse_to_replace(value, param.opts[0], session_of(ctx))
    return value


def refuse_to_replace(path: Path, option: str, session: Session) -> None:
    """A file that is there is not replaced unasked.

    Raises
    ------
    InputError
    """
    if path.is_file() and not session.replaces:
        raise InputError(f"{path} exists and is not replaced: name another file for {option}, or give --force")
    refuse_unwritable(path, option)


def refuse_unwritable(path: Path, option: str) -> None:
    """Refuse a file that cannot be written where it is to be, before anything moves; nothing is left behind.

    A folder that does not exist yet is taken for one that can be made if that can be written which is there.

    Raises
    ------
    InputError
    """
    folder = path.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        why = error.strerror or error
        raise InputError(
            f"{option} {path}: cannot be written in {folder}: {why}; check the path and its permissions"
        ) from error


def recording_file(_ctx: click.Context, param: click.Parameter, value: Path) -> Path:
    """A recording to write or to go on with; it is found out before anything moves that it can be written."""
    refuse_unwritable(value, param.opts[0])
    return value


def writes(*options: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Add options that name files to write, and --force, once a command."""

    def added(function: Function) -> Function:
        for option in reversed(options):
            function = option(function)
        known = getattr(function, "__click_params__", [])
        return function if any("--force" in each.opts for each in known) else _force(function)

    return added


_force = click.option(
    "--force",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_forced,
    help="Replace files that are there already.",
)


def output_option(*names: str, metavar: str, help: str, required: bool = False) -> Callable[[Function], Function]:
    """A file that is written, with --force."""
    kind = click.Path(path_type=Path, dir_okay=False)
    return writes(click.option(*names, type=kind, metavar=metavar, required=required, callback=new_file, help=help))


def _json_target(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    if value == "-":
        session_of(ctx).data_on_stdout = True
    elif value is not None:
        path = Path(value)
        if not path.parent.is_dir():
            raise InputError(f"--json {value}: the folder {path.parent} does not exist: make it, or name another file")
        new_file(ctx, param, path)
    return value


json_option = writes(
    click.option(
        "--json", "json_out", metavar="OUT", callback=_json_target, help="Write the result as JSON; - for stdout."
    )
)
trace_option = output_option("--trace", metavar="FILE", help="Frame log (.blf, .log).")


def _label(_ctx: click.Context, _param: click.Parameter, value: str | tuple[str, ...]) -> str | tuple[str, ...]:
    """Labels of loads; what can only mean the bare arm is a usage error."""
    labels = (value,) if isinstance(value, str) else value
    for label in labels:
        wrong = label_refused(label)
        if wrong:
            raise click.BadParameter(f"'{label}' {wrong}")
    return value


def load_option(name: str, help: str, **settings: Any) -> Callable[[Function], Function]:
    """--load: what hangs on the flange while it is measured."""
    return click.option("--load", name, metavar="LABEL", callback=_label, help=help, **settings)


operator_option = click.option("--operator", metavar="NAME", help="Who measures: stands in the report, to be signed.")


def _expected(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> tuple[Expected, ...]:
    from gateway.result.acceptance import parse_expected

    return tuple(parse_expected(text) for text in value)


def accept_options(function: Function) -> Function:
    """Add the options of ACCEPT."""
    function = output_option("--junit", "junit_file", metavar="FILE", help="Write pass and fail as JUnit XML.")(
        function
    )
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


warm_option = click.option(
    "--warm",
    "is_warm",
    is_flag=True,
    help="The arm was warm in all runs: torque readings did not change with temperature (0.7 % an axis otherwise).",
)


def model_options(function: Function) -> Function:
    """Add the options of MODEL."""
    for option in (
        click.option(
            "--torque-gain",
            metavar="exact|prior:S",
            help="How far the torque constants are trusted; the cell's std_percent if omitted, prior:0.03 for tables.",
        ),
        warm_option,
        click.option("--bare", type=click.Path(path_type=Path, dir_okay=False), help="Stored bare identification."),
        click.option(
            "--known",
            multiple=True,
            metavar=KNOWN_FORM,
            help=f"A load that is known. {KNOWN_HELP}",
        ),
        click.option(
            "--inertials", metavar="exact|prior:S|ignore", help="How far the URDF's link inertials are trusted."
        ),
        click.option("--cell", "cell_file", type=click.Path(path_type=Path, dir_okay=False), help="Cell file."),
        click.option(
            "--tip", metavar="LINK", help="Last link of the arm in the URDF; what moves elsewhere is fixed at zero."
        ),
        click.option("--robot", type=click.Path(path_type=Path, dir_okay=False), help="Robot as URDF."),
    ):
        function = option(function)
    return function


data_argument = click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path, dir_okay=False))


def note_remarks(robot: Robot | None) -> None:
    """Print what of a robot description is not used as it is written, or is a placeholder."""
    from gateway.model.placeholders import placeholders

    for remark in () if robot is None else (*robot.remarks, *placeholders(robot)):
        session_of().note(remark)


def write_json(target: str, payload: Mapping[str, Any]) -> None:
    """Write JSON to a file (replaced whole) or, for `-`, to stdout; a NaN is a defect and raises."""
    text = json.dumps(payload, indent=1, allow_nan=False) + "\n"
    if target == "-":
        click.echo(text, nl=False)
    else:
        replace_file(Path(target), text)


def show_remarks(name: str, remarks: Sequence[Remark]) -> None:
    """Print which lines of a data sheet are not used; the first ten, all of them with -v."""
    session = session_of()
    shown = remarks if session.verbosity > 0 else remarks[:REMARKS_SHOWN]
    for remark in shown:
        session.note(f"{name} {remark}")
    if len(shown) < len(remarks):
        session.note(f"{name}: {len(remarks) - len(shown)} more lines are not used as written (-v names them)")


def key_values(option: str, pairs: Sequence[str], keys: Collection[str] = ()) -> dict[str, str]:
    """Values of a repeatable option by their keys.

    Parameters
    ----------
    option : str
        Its name, for the message.
    pairs : sequence of str
        KEY=VALUE as typed.
    keys : collection of str
        Keys that there are; empty = any.

    Raises
    ------
    click.UsageError
        One without an equals sign, or with another key.
    """
    found: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or not key or (keys and key not in keys):
            of = f" with one of {', '.join(keys)}" if keys else ""
            raise click.UsageError(f"{option} '{pair}': write KEY=VALUE{of}.")
        found[key] = value
    return found


#: What is said where a person does not agree.
NOT_AGREED = "not agreed to: nothing has moved, nothing was written"


def confirm(question: str, *, yes: bool) -> None:
    """Ask before anything moves; no answer means no.

    Raises
    ------
    click.Abort
        It says that nothing has moved.
    """
    if yes:
        return
    context = click.get_current_context(silent=True)
    if context is not None:
        session_of(context).settle()
    try:
        agreed = click.confirm(question, err=True)
    except click.Abort:
        agreed = False
    if not agreed:
        raise click.Abort(NOT_AGREED)


def _unit(ctx: click.Context, _param: click.Parameter, value: str) -> None:
    session_of(ctx).in_degrees = value == "deg"


unit_option = click.option(
    "--unit",
    type=click.Choice(["rad", "deg"]),
    default="rad",
    show_default=True,
    is_eager=True,
    expose_value=False,
    callback=_unit,
    help="Unit of the joint angles that are typed.",
)


def joint_angles(text: str, session: Session) -> tuple[float, ...]:
    """Joint angles [rad] of `J1,J2,..` in the unit of `--unit`; anything else is a usage error."""
    unit, example = ("deg", "0,-30,70,0,20,0") if session.in_degrees else ("rad", "0,-0.5,1.2,0,0.4,0")
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise click.BadParameter(f"'{text}': give joint angles in {unit}, one per axis, such as {example}")
    if session.in_degrees:
        return tuple(map(math.radians, values))
    if max(map(abs, values)) > LARGEST_ANGLE_RAD:
        raise click.BadParameter(f"'{text}': rad is meant, and these can only be degrees: add --unit deg")
    return values


def one_of(names: Sequence[str]) -> click.Choice[str]:
    """A choice among names, spelled exactly."""
    return click.Choice(list(names))
