"""Options that several commands share."""

from __future__ import annotations

import contextlib
import json
import math
import select
import sys
import tempfile
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from drives.files import replace_file
from gateway.cell.plausible import LARGEST_ANGLE_RAD
from gateway.commands.console import Session
from gateway.data.labels import label_refused
from gateway.errors import InputError

if TYPE_CHECKING:
    from drives.bus_spec import BusSpec
    from drives.datasheet.sheet import Remark
    from gateway.jobs.cell_context import CellContext
    from gateway.model.robot import Robot
    from gateway.pipeline.known import KnownLoad
    from gateway.result.acceptance import Expected
#: A file on the command line.
FILE = click.Path(path_type=Path, dir_okay=False)

#: Number of data sheet remarks printed without -v.
REMARKS_SHOWN = 10

KNOWN_FORM = "LABEL=MASS[+-STD][,[FRAME=]X,Y,Z[+-STD]]"
KNOWN_HELP = (
    "kg and m. FRAME: flange or link_6 (the last link, default). Without X,Y,Z the centre of gravity is estimated."
    " STD: standard deviation of the mass, and of each coordinate of the centre; without it they are exact."
)

Function = TypeVar("Function", bound=Callable[..., Any])


def session_of(ctx: click.Context | None = None) -> Session:
    """Return the session of the running command."""
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
        "-v", "--verbose", count=True, expose_value=False, callback=_louder, help="More output; twice for all details."
    )(function)
    return click.option("-q", "--quiet", is_flag=True, expose_value=False, callback=_quieter, help="Errors only.")(
        function
    )


def _forced(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    session_of(ctx).replaces = value


def new_file(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Return a file to write; an existing one is refused without --force.

    Raises
    ------
    InputError
    """
    if value is not None:
        refuse_to_replace(value, param.opts[0], session_of(ctx))
    return value


def refuse_to_replace(path: Path, option: str, session: Session) -> None:
    """Refuse to replace an existing file without --force.

    Raises
    ------
    InputError
    """
    if path.is_file() and not session.replaces:
        raise InputError(f"{path} exists: choose another file for {option}, or replace it with --force")
    refuse_unwritable(path, option)


def refuse_unwritable(path: Path, option: str) -> None:
    """Refuse a file that cannot be written, before any motion; no file is created.

    A missing folder is accepted if its nearest existing parent is writable.

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
    """Return a recording to write or continue; refused before any motion if it cannot be written."""
    refuse_unwritable(value, param.opts[0])
    return value


def writes(*options: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Add options for files to write, and --force once per command."""

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
    help="Replace existing files.",
)


def output_option(*names: str, metavar: str, help: str, required: bool = False) -> Callable[[Function], Function]:
    """Return an option for a file to write, with --force."""
    return writes(click.option(*names, type=FILE, metavar=metavar, required=required, callback=new_file, help=help))


def folder_options(recording: str) -> Callable[[Function], Function]:
    """Return -o FOLDER and --resume of a command that measures into a folder."""

    def decorate(command: Function) -> Function:
        resume = f"Continue FOLDER/{recording} instead of starting a new recording."
        command = click.option("--resume", is_flag=True, help=resume)(command)
        return click.option(
            "-o",
            "--output",
            "out",
            metavar="FOLDER",
            type=click.Path(path_type=Path, file_okay=False),
            default=Path("out"),
            show_default=True,
            help="Folder of all files that are written.",
        )(command)

    return decorate


def measurement_options(data: str, recording: str) -> Callable[[Function], Function]:
    """Return --from DATA, -o and --resume of a command that moves through poses, or reads `data` instead."""

    def decorate(command: Function) -> Function:
        command = folder_options(recording)(command)
        return click.option(
            "--from",
            "data",
            multiple=True,
            metavar="DATA",
            type=FILE,
            help=f"Recordings or tables {data}; nothing moves. Repeatable.",
        )(command)

    return decorate


def _json_target(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    if value == "-":
        session_of(ctx).data_on_stdout = True
    elif value is not None:
        new_file(ctx, param, Path(value))
    return value


json_option = writes(
    click.option(
        "--json", "json_out", metavar="OUT", callback=_json_target, help="Write the result as JSON; - for stdout."
    )
)
trace_option = output_option("--trace", metavar="FILE", help="Frame log (.blf, .log).")


def _label(
    _ctx: click.Context, _param: click.Parameter, value: str | tuple[str, ...] | None
) -> str | tuple[str, ...] | None:
    """Return load labels; one that can only mean the unloaded arm is a usage error."""
    labels = (value,) if isinstance(value, str) else value or ()
    for label in labels:
        wrong = label_refused(label)
        if wrong:
            raise click.BadParameter(f"'{label}' {wrong}")
    return value


def load_option(name: str, help: str, **settings: Any) -> Callable[[Function], Function]:
    """Return option --load: label of a load."""
    return click.option("--load", name, metavar="LABEL", callback=_label, help=help, **settings)


operator_option = click.option("--operator", metavar="NAME", help="Name of the operator, for the report.")


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
        help="Expected mass of a load and tolerance [kg]; repeatable. Result: pass, fail or cannot tell.",
    )(function)


bus_option = click.option(
    "--bus",
    "bus_spec",
    metavar="SPEC",
    help="Bus to use instead of that of the cell file; NAME=SPEC;NAME=SPEC for a cell with several buses.",
)
cell_argument = click.argument("cell", type=FILE)
#: A result of the arm, or `CELL.loads.json#LABEL`.
result_argument = click.argument("load_file", metavar="RESULT", type=FILE)


warm_option = click.option(
    "--warm",
    "is_warm",
    is_flag=True,
    help="The arm was warm in all runs: no change of the torque reading with temperature (otherwise 0.7 % per axis "
    "is assumed).",
)


def model_options(function: Function) -> Function:
    """Add the options of MODEL."""
    for option in (
        click.option(
            "--torque-gain",
            metavar="S",
            help="Relative standard deviation of the torque constants, 0 for exact; default: std_percent of the cell, "
            "0.03 for tables.",
        ),
        warm_option,
        click.option("--bare", type=FILE, help="Stored result of the unloaded arm."),
        click.option(
            "--known",
            multiple=True,
            metavar=KNOWN_FORM,
            help=f"A known load. {KNOWN_HELP}",
        ),
        click.option(
            "--inertials",
            metavar="S|ignore",
            help="Relative standard deviation of the link masses of the URDF; 0 for exact.",
        ),
        click.option("--cell", "cell_file", type=FILE, help="Cell file."),
        click.option("--tip", metavar="LINK", help="Last link of the arm in the URDF; other joints are fixed at zero."),
        click.option("--robot", type=FILE, help="Robot as URDF."),
    ):
        function = option(function)
    return function


def known_loads(texts: Sequence[str]) -> dict[str, KnownLoad]:
    """Return the loads of --known by label.

    Raises
    ------
    click.UsageError
        A load is given twice.
    """
    from gateway.pipeline.known import parse_known

    known: dict[str, KnownLoad] = {}
    for label, load in map(parse_known, texts):
        if label in known:
            raise click.UsageError(f"--known {label} is given twice: give each load once")
        known[label] = load
    return known


data_argument = click.argument("data", nargs=-1, required=True, type=FILE)


def note_remarks(robot: Robot | None) -> None:
    """Print the parts of a robot description that are ignored or placeholders."""
    from gateway.model.placeholders import model_remarks

    for remark in () if robot is None else model_remarks(robot):
        session_of().note(remark)


def write_json(target: str | None, payload: Mapping[str, Any]) -> None:
    """Write JSON to a file (atomically) or, for `-`, to stdout; None and "" write nothing, a NaN raises an error."""
    if not target:
        return
    text = json.dumps(payload, indent=1, allow_nan=False) + "\n"
    if target == "-":
        click.echo(text, nl=False)
    else:
        replace_file(Path(target), text)


def show_remarks(name: str, remarks: Sequence[Remark]) -> None:
    """Print the data sheet lines that are not used; the first ten, all with -v."""
    session = session_of()
    shown = remarks if session.verbosity > 0 else remarks[:REMARKS_SHOWN]
    for remark in shown:
        session.note(f"{name} {remark}")
    if len(shown) < len(remarks):
        session.note(f"{name}: {len(remarks) - len(shown)} more lines are not used as written (list them with -v)")


def key_values(option: str, pairs: Sequence[str], keys: Collection[str] = ()) -> dict[str, str]:
    """Return the values of a repeatable option by key.

    Parameters
    ----------
    option : str
        Name of the option, for the message.
    pairs : sequence of str
        KEY=VALUE as typed.
    keys : collection of str
        Allowed keys; empty = any.

    Raises
    ------
    click.UsageError
        An entry has no equals sign or an unknown key.
    """
    found: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or not key or (keys and key not in keys):
            of = f" with one of {', '.join(keys)}" if keys else ""
            raise click.UsageError(f"{option} '{pair}': write KEY=VALUE{of}.")
        found[key] = value
    return found


def reserve(spec: BusSpec) -> None:
    """Lock a bus against other commands on this computer until the running command ends.

    Raises
    ------
    BusError
        Another command uses this bus.
    """
    from drives.bus_lock import bus_locked

    context = click.get_current_context(silent=True)
    if context is None:  # called as a function: the caller decides
        return
    reserved: set[str] = context.meta.setdefault("servo-gateway.buses", set())
    if spec.wire not in reserved:
        context.with_resource(bus_locked(spec, context.command_path))
        reserved.add(spec.wire)


def cell_context(cell: Path, bus_spec: str | None = None, pacing: str | None = None) -> CellContext:
    """Read a cell file; each bus that is used is locked until the running command ends. As `open_cell`."""
    from gateway.jobs.cell_context import open_cell

    return open_cell(cell, bus_spec, reserve, pacing)


def drop_typed_ahead() -> None:
    """Drop what was typed at the terminal before a prompt; input from a pipe or a file is kept."""
    if sys.stdin is None or not sys.stdin.isatty():
        return
    with contextlib.suppress(ImportError):  # Windows has no termios; no command moves an arm there
        import termios

        termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)


def typed_line(prompt: str, meanwhile: Callable[[], None] | None = None, *, err: bool = True) -> str:
    """Return the line that is typed after a prompt, without its end; what was typed before does not count.

    Parameters
    ----------
    prompt : str
        Empty: a further line of the answer to an earlier prompt.
    meanwhile : callable, optional
        At a terminal, called again and again until a line was typed.
    err : bool
        Show the prompt on standard error, not on standard output.

    Raises
    ------
    click.Abort
        The input has ended.
    """
    context = click.get_current_context(silent=True)
    if context is not None:
        session_of(context).settle()
    line = ""
    with _line_by_line():
        if prompt:
            drop_typed_ahead()
            click.echo(prompt, nl=False, err=err)
        try:
            while meanwhile is not None and not _is_answered():
                meanwhile()
            with contextlib.suppress(OSError):  # the terminal was closed
                line = "" if sys.stdin is None else sys.stdin.readline()
        finally:
            if prompt and not (line + prompt).endswith("\n"):
                with contextlib.suppress(OSError):  # the terminal was closed
                    click.echo(err=err)  # what is said next begins on a line of its own
    if not line:
        raise click.Abort
    return line.strip()


def _is_answered() -> bool:
    """Return whether a line can be read at once; what is not a terminal is read as it comes."""
    return sys.stdin is None or not sys.stdin.isatty() or bool(select.select([sys.stdin], [], [], 0.0)[0])


@contextlib.contextmanager
def _line_by_line() -> Generator[None]:
    """Have the terminal show and correct what is typed, also where hold-to-run reads its keys one by one."""
    if sys.stdin is None or not sys.stdin.isatty():
        yield
        return
    import termios

    from gateway.motion.stops import terminal_mode

    with terminal_mode(sys.stdin.fileno()) as mode:
        mode[3] |= termios.ICANON | termios.ECHO
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, mode)
        yield


def agreed(question: str, meanwhile: Callable[[], None] | None = None) -> bool:
    """Ask for confirmation, and return the answer; none means no."""
    answer = ""
    while answer not in ("y", "yes", "n", "no"):
        try:
            answer = typed_line(f"{question} [y/N]: ", meanwhile).lower() or "no"
        except click.Abort:
            answer = "no"
    return answer in ("y", "yes")


def confirm(question: str, declined: str, meanwhile: Callable[[], None] | None = None) -> None:
    """Ask for confirmation as `agreed` does.

    Raises
    ------
    click.Abort
        With the text `declined`.
    """
    if not agreed(question, meanwhile):
        raise click.Abort(declined)


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
    help="Unit of the joint angles on the command line.",
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
        raise click.BadParameter(f"'{text}': these values are too large for radians: add --unit deg for degrees")
    return values


def effect_names(_ctx: click.Context, _param: click.Parameter, value: str | None) -> frozenset[str]:
    """Return effect names from comma-separated text; an unknown one is a usage error."""
    from gateway.model.effects import LIBRARY

    names = frozenset(part.strip() for part in (value or "").split(",") if part.strip())
    unknown = sorted(names - set(LIBRARY))
    if unknown:
        raise click.BadParameter(f"'{unknown[0]}' is not an effect; choose from {', '.join(sorted(LIBRARY))}")
    return names
