"""Options that several commands share."""

from __future__ import annotations

import contextlib
import json
import math
import select
import sys
import tempfile
from collections.abc import Callable, Generator, Mapping, Sequence
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


class FilePath(click.Path):
    """Path of a file that a command reads or writes; a file that is written has one argument alone.

    Parameters
    ----------
    is_written : bool
    *replaced : str
        Suffixes of the files to write that are replaced, such as .json, because a command can compute them again.
        Recordings, tables and files that are edited by hand are none.
    """

    def __init__(self, is_written: bool, *replaced: str) -> None:
        super().__init__(path_type=Path, dir_okay=False)
        self._is_written, self._replaced = is_written, replaced

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; `-` passes where JSON is written.

        Raises
        ------
        InputError
            The file to write exists and is not replaced, or cannot be written.
        """
        if ctx is None or param is None or (value == "-" and self is JSON_FILE):
            return value
        path: Any = super().convert(value, param, ctx)
        is_written: dict[Path, bool] = ctx.meta.setdefault("servo-gateway.files", {})
        place = path.resolve()
        if place in is_written and (self._is_written or is_written[place]):
            raise click.BadParameter(f"{path} is used for another argument: choose another file", ctx, param)
        is_written[place] = self._is_written
        if self._is_written:
            if path.suffix not in self._replaced:
                refuse_to_replace(path, param.opts[0])
            refuse_unwritable(path, param.opts[0])
        return path


#: Files on the command line: one that is read, and those that are written.
FILE, NEW_FILE = FilePath(is_written=False), FilePath(is_written=True)
JSON_FILE, PAGE_FILE = FilePath(True, ".json"), FilePath(True, ".html", ".pdf")


def refuse_to_replace(path: Path, option: str) -> None:
    """Refuse a file that exists.

    Raises
    ------
    InputError
    """
    if path.is_file():
        raise InputError(f"{path} exists and is not replaced: choose another name for {option}, or move that file")


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


def page_option(required: bool = False) -> Callable[[Function], Function]:
    """Return -o PAGE.html."""
    help = "Page to write; .pdf is printed by an installed browser."
    return click.option("-o", "--output", metavar="PAGE.html", type=PAGE_FILE, required=required, help=help)


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


def _json_target(ctx: click.Context, _param: click.Parameter, value: Path | str | None) -> str | None:
    session_of(ctx).data_on_stdout |= value == "-"
    return None if value is None else str(value)


json_option = click.option(
    "--json",
    "json_out",
    metavar="OUT",
    type=JSON_FILE,
    callback=_json_target,
    help="Write the result as JSON; - for stdout.",
)
junit_option = click.option(
    "--junit", "junit_file", metavar="FILE", type=FilePath(True, ".xml"), help="Write pass and fail as JUnit XML."
)
trace_option = click.option("--trace", metavar="FILE", type=NEW_FILE, help="Frame log (.blf, .log).")


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
    function = junit_option(function)
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
    help="Bus instead of that of the cell file: INTERFACE:CHANNEL[,key=value].., such as socketcan:can0; for a cell "
    "with several buses NAME=SPEC;NAME=SPEC.",
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


def key_values(option: str, pairs: Sequence[str]) -> dict[str, str]:
    """Return the values of a repeatable option by key.

    Parameters
    ----------
    option : str
        Name of the option, for the message.
    pairs : sequence of str
        KEY=VALUE as typed.

    Raises
    ------
    click.UsageError
        An entry has no key or no equals sign.
    """
    found: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or not key:
            raise click.UsageError(f"{option} '{pair}': write KEY=VALUE.")
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


def joint_angles(text: str) -> tuple[float, ...]:
    """Joint angles [rad] of `J1,J2,..`, or in degrees of `J1,J2,..deg`; anything else is a usage error."""
    typed = text.strip().lower()
    in_degrees = typed.endswith("deg")
    try:
        values = tuple(float(part) for part in typed.removesuffix("deg").split(","))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        examples = "0,-0.5,1.2,0,0.4,0 (radians) or 0,-30,70,0,20,0deg"
        raise click.BadParameter(f"'{text}': give one joint angle per axis, such as {examples}")
    if in_degrees:
        return tuple(map(math.radians, values))
    if max(map(abs, values)) > LARGEST_ANGLE_RAD:
        raise click.BadParameter(f"'{text}': these values are too large for radians: write {text}deg for degrees")
    return values


def effect_names(_ctx: click.Context, _param: click.Parameter, value: str | None) -> frozenset[str]:
    """Return effect names from comma-separated text; an unknown one is a usage error."""
    from gateway.model.effects import LIBRARY

    names = frozenset(part.strip() for part in (value or "").split(",") if part.strip())
    unknown = sorted(names - set(LIBRARY))
    if unknown:
        raise click.BadParameter(f"'{unknown[0]}' is not an effect; choose from {', '.join(sorted(LIBRARY))}")
    return names
