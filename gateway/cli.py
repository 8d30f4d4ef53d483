"""servo-gateway: parse, call one function, print, and turn every error into one paragraph and an exit code.

    0    done
    1    a defect of this program (details go to a log file that the message names)
    2    usage
    3    configuration or input file
    4    bus or drive
    5    plan refused, or motion stopped
    6    data cannot answer the question
    7    finished, a failing finding stands
    130  stopped by a person, a signal or a closed terminal; the arm is in its brakes, what was measured is kept

Each command lives in `gateway/commands` and is imported when it is called, so that `--help` stays fast.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import keyword
import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

import click

from drives.printable import without_controls
from gateway import __version__
from gateway.errors import ENDING_SIGNALS, IN_BRAKES, NOT_CONFIRMED
from gateway.motion.stops import StoppedByPerson, output_closed

PROGRAM = "servo-gateway"
CTRL_C = 130
#: What the system says of a file that it has no room for.
NO_SPACE = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT})

# command -> (module of gateway.commands, one line of help)
COMMANDS: dict[str, tuple[str, str]] = {
    "scan": ("bus", "Who is on the bus: identity, firmware, NMT state, matching profile."),
    "check": ("bus", "Pre-flight check of a cell: drives against profile and cell file."),
    "live": ("live", "A page in the browser of what happens on the bus: watches, sends nothing."),
    "restore": ("bus", "Put back what the write ledger holds."),
    "config": ("config", "Configuration of the drives as DCF: dump, diff, apply."),
    "move": ("move", "Go home, to where loads are hung, or to joint angles: slowly, asked, inside every limit."),
    "plan": ("measure", "Choose rest poses: limits, duration, expected uncertainty (needs no bus)."),
    "record": ("measure", "Measure the rest poses under one load into RUN.h5."),
    "commission": ("guided", "All of it, guided: from the check to the report."),
    "calibrate": ("calibrate", "Torque constants from a weighed load, guided; stored beside the cell file."),
    "estimate": ("identification", "Mass and centre of gravity of the load(s) from DATA."),
    "diagnose": ("identification", "What the model lacks, judged on data that no fit has seen."),
    "compare": ("compare", "Two results of one robot, before and after service: what changed."),
    "accept": ("accept", "A load that was entered, judged at unseen poses over the workspace."),
    "replay": ("replay", "A stored measurement, computed again: what differs."),
    "report": ("report_export", "One HTML page from a result."),
    "export": ("report_export", "A load in a robot controller's syntax; a recording for other programs."),
    "import": ("report_export", "A measured table from another program's log, by a map of its columns."),
    "follow": ("follow_command", "Following error without, with maximum-load and with identified feedforward."),
    "teach": ("pair", "Two arms: the first function from points where the force is adjusted away."),
    "run-pair": ("pair", "Two arms: carry the part along the path, learning from force."),
    "learn": ("pair", "Two arms: status of what was learned, learning off and on, forget it."),
    "pair-report": ("pair", "Two arms: one HTML page, force along the path and convergence."),
    "fleet": ("fleet", "Many robots over months: ingest, analyse, report."),
    "cell": ("cell", "Cell files: new, schema."),
    "doctor": ("doctor", "This computer: Python, real time, CAN interfaces, clock, browser, disk."),
    "completion": ("completion", "Completion of commands and options for bash, zsh or fish."),
    "profiles": ("profiles", "Drive profiles: list, show, schema; new drafts one from an EDS."),
}


class LadderGroup(click.Group):
    """Commands by name, imported when called; every error becomes one paragraph and an exit code."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the job."""
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command and return it."""
        del ctx
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"gateway.commands.{COMMANDS[cmd_name][0]}")
        name = cmd_name.replace("-", "_")
        return getattr(module, f"{name}_" if keyword.iskeyword(name) else name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does, with commands that are spelled alike, which it only knows of those that are imported."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError:
            import difflib

            near = difflib.get_close_matches(args[0], COMMANDS, 3)
            did = f" Did you mean {' or '.join(near)}?" if near else ""
            raise click.UsageError(f"No such command '{args[0]}'.{did}", ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; click would answer an interrupt and a closed terminal in its own way."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise click.exceptions.Exit(report_error(error)) from error
        except BrokenPipeError as error:
            raise click.exceptions.Exit(_unheard(error)) from error

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command line and leave with its exit code."""
        del standalone_mode
        if args is None:
            _end_by_signal()
        try:
            code = super().main(
                args,
                prog_name=prog_name or PROGRAM,
                complete_var=complete_var,
                standalone_mode=False,
                windows_expand_args=windows_expand_args,
                **extra,
            )
        except BaseException as error:
            code = _unheard(error) if output_closed(error) else report_error(error)
        if args is None and code == CTRL_C:
            _hear_no_signal()
        sys.exit(code if isinstance(code, int) else 0)


def _unheard(error: BaseException) -> int:
    """Exit code where nobody reads the output any more: of what had happened before that was noticed, else 0."""
    _let_go_of_terminal()
    before: BaseException | None = error
    while (before := before.__context__) is not None:
        if isinstance(before, click.Abort | KeyboardInterrupt):
            return CTRL_C
        code = getattr(before, "exit_code", None)
        if isinstance(code, int):
            return code
    return 0


def _end_by_signal() -> None:
    """Signals that end a program end it as Ctrl-C does, from the start on; what `nohup` has silenced stays so."""

    def stopped(number: int, _frame: Any) -> None:
        raise StoppedByPerson(f"stopped by {signal.Signals(number).name}")

    for number in ENDING_SIGNALS:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, stopped)


def _hear_no_signal() -> None:
    """A second Ctrl-C while the interpreter ends would replace the exit code."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _let_go_of_terminal() -> None:
    """What is still written goes nowhere, instead of failing when the program ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(nowhere, stream.fileno())


def report_error(error: BaseException) -> int:
    """Write one paragraph about `error` to stderr and return the exit code that belongs to it."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, click.Abort | KeyboardInterrupt):
        if isinstance(error, click.Abort) and str(error):
            _say(str(error))
            return CTRL_C
        # only a command that had an arm under power knows what it does: that is among the notes
        why = str(error) if isinstance(error, StoppedByPerson) else "stopped"
        notes = [note.removesuffix(".") for note in getattr(error, "__notes__", [])]
        known = sorted(notes, key=lambda note: note not in (IN_BRAKES, NOT_CONFIRMED))
        _say(f"{why}: {'. '.join(known)}" if known else why)
        return CTRL_C
    if isinstance(error, click.ClickException):
        error.show()
        return error.exit_code
    code = getattr(error, "exit_code", None)
    if isinstance(code, int):
        _say(f"error: {_told(error)}")
        return code
    if isinstance(error, OSError) and error.errno in NO_SPACE:
        _say(f"error: {error.filename or 'a file'}: {paragraph(error)}; free some space or choose another folder")
        return 3
    if isinstance(error, OSError) and error.filename is not None:
        _say(f"error: {error.filename}: {error.strerror}; check the path and its permissions")
        return 3
    _say(f"error: {_defect(error)}")
    return 1


def _say(text: str) -> None:
    """To stderr, if anybody is there to read it."""
    try:
        from gateway.result.numerals import with_degrees

        click.echo(with_degrees(without_controls(text, keep="\n\t")), err=True)
    except (OSError, AttributeError):
        _let_go_of_terminal()


def _told(error: BaseException) -> str:
    """One paragraph; a line per problem where a file has several."""
    lines = getattr(error, "lines", ())
    return "\n".join([*lines, *getattr(error, "__notes__", [])]) if lines else paragraph(error)


def paragraph(error: BaseException) -> str:
    """The message of an error and of its notes on one line; what was said already is not said again.

    A note that begins with a capital letter is a sentence of its own.
    """
    text = " ".join((str(error) or type(error).__name__).split())
    for note in getattr(error, "__notes__", []):
        said = " ".join(note.split())
        if said and said not in text:
            mark = "" if text[-1] in ".;:?!" else "." if said[0].isupper() else ";"
            text = f"{text}{mark} {said}"
    return text


def _defect(error: BaseException) -> str:
    try:
        import tempfile  # these two take as long to load as all else that `--help` needs
        import traceback

        handle, path = tempfile.mkstemp(prefix=f"{PROGRAM}-", suffix=".log")
        with os.fdopen(handle, "w", encoding="utf-8") as log:
            log.write("".join(traceback.format_exception(error)))
    except OSError as failed:
        path = f"no file, which cannot be written ({failed})"
    return (
        f"this is a defect of {PROGRAM}: {type(error).__name__}: {paragraph(error)}. "
        f"The details are in {path}; please report them"
    )


@click.group(
    cls=LadderGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="SPEC: INTERFACE:CHANNEL[,key=value]..., such as socketcan:can0 or udp_multicast:239.74.163.2,port=43113",
)
@click.option("-v", "--verbose", count=True, help="Say more; twice for every detail.")
@click.option("-q", "--quiet", is_flag=True, help="Errors only.")
@click.version_option(__version__, prog_name=PROGRAM)
@click.pass_context
def main(ctx: click.Context, verbose: int, quiet: bool) -> None:
    """CANopen master for six-axis robots: what hangs on the flange, how sure that is, and why the residual is there."""
    from gateway.commands.console import Session

    ctx.obj = Session(verbosity=verbose - (1 if quiet else 0))


if __name__ == "__main__":
    main()
