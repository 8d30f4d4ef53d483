"""Command line of servo-gateway: every error becomes one paragraph and an exit code.

    0    done
    1    a defect of this program (the message names the log file with details)
    2    usage
    3    configuration or input file
    4    bus or drive
    5    plan refused, or motion stopped
    6    data insufficient for the result
    7    finished with a failing finding
    130  stopped by the operator, a signal or a closed terminal; measured data kept

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
from gateway.errors import ENDING_SIGNALS
from gateway.motion.stops import StoppedByPerson, output_closed

PROGRAM = "servo-gateway"
CTRL_C = 130
#: Error numbers of a full disk.
NO_SPACE = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT})

# command -> (group of the help, module of gateway.commands, one line of help), in the order of the job
COMMANDS: dict[str, tuple[str, str, str]] = {
    "scan": ("Look", "bus", "List the nodes on the bus: identity, firmware, NMT state, profile."),
    "doctor": ("Look", "doctor", "Check this computer: Python, real time, CAN, clock, browser, disk."),
    "live": ("Look", "live", "Show the arms of a cell in a browser; the bus is only read."),
    "profiles": ("Look", "profiles", "Drive profiles: list, show, schema; new drafts one from an EDS."),
    "cell": ("Prepare", "cell", "Cell files: new, view, schema."),
    "check": ("Prepare", "bus", "Check the drives: profile, cell file; then moves, brakes, timing."),
    "config": ("Prepare", "config", "Drive parameters as DCF files: dump, diff, apply."),
    "restore": ("Prepare", "bus", "Restore the drive parameters recorded in the write ledger."),
    "calibrate": ("Prepare", "calibrate", "Calibrate torque constants with a weighed load."),
    "plan": ("Measure", "measure", "Choose rest poses or motions: limits, duration, uncertainty."),
    "move": ("Measure", "move", "Move an arm to its home or loading posture, or to joint angles."),
    "record": ("Measure", "measure", "Measure rest poses or motions under one load into RUN.h5."),
    "commission": ("Measure", "guided", "Guided commissioning, from the check to the report."),
    "accept": ("Measure", "accept", "Validate an entered load at unseen poses over the workspace."),
    "estimate": ("Analyse", "identification", "Estimate mass and centre of gravity of each load from DATA."),
    "diagnose": ("Analyse", "identification", "Find the effects that the model lacks, validated on held-out data."),
    "compare": ("Analyse", "compare", "Compare two results of one robot, before and after service."),
    "rehearse": ("Analyse", "rehearse", "What a plan would find: known effects put into simulated arms."),
    "cost": ("Analyse", "cost", "Cycle time and torque reserve before and after a load is entered."),
    "replay": ("Analyse", "replay", "Recompute a stored measurement and list the differences."),
    "report": ("Hand over", "report_export", "Write an HTML page from a result, a rehearsal or a stopped run."),
    "export": ("Hand over", "report_export", "Export a load for a controller, or a recording for other programs."),
    "import": ("Hand over", "report_export", "Convert the log of another program to a measured table."),
    "follow": ("Others", "follow_command", "Following error without, with maximum and with identified load."),
    "pair": ("Others", "pair", "Two arms that carry one workpiece: teach, run, learn, report."),
    "fleet": ("Others", "fleet", "Monitor many robots over months: ingest, analyse, report."),
    "completion": ("Others", "completion", "Shell completion for bash, zsh or fish."),
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
        module = importlib.import_module(f"gateway.commands.{COMMANDS[cmd_name][1]}")
        name = cmd_name.replace("-", "_")
        return getattr(module, f"{name}_" if keyword.iskeyword(name) else name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of a name; the error for an unknown one proposes similar names."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError:
            import difflib

            near = difflib.get_close_matches(args[0], COMMANDS, 3)
            did = f" Did you mean {' or '.join(near)}?" if near else ""
            raise click.UsageError(f"No such command '{args[0]}'.{did}", ctx) from None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by group on one screen without importing them, then the options in one line."""
        del ctx
        width = max(map(len, COMMANDS))
        formatter.write_paragraph()
        for group in dict.fromkeys(row[0] for row in COMMANDS.values()):
            rows = [f"  {name:{width}}  {row[2]}\n" for name, row in COMMANDS.items() if row[0] == group]
            formatter.write("".join([f"{group}:\n", *rows]))
        formatter.write("\nOptions: -v, -vv more output; -q errors only; --version; -h, --help\n")

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; handle an interrupt and a closed terminal here instead of in click."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise click.exceptions.Exit(report_error(error)) from error
        except BrokenPipeError as error:
            raise click.exceptions.Exit(_code_after_closed_output(error)) from error

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

            def stopped(number: int, _frame: Any) -> None:
                raise StoppedByPerson(f"stopped by {signal.Signals(number).name}")

            for number in ENDING_SIGNALS:
                if signal.getsignal(number) == signal.SIG_DFL:
                    signal.signal(number, stopped)
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
            code = _code_after_closed_output(error) if output_closed(error) else report_error(error)
        if args is None and code == CTRL_C:
            _ignore_signals()
        sys.exit(code if isinstance(code, int) else 0)


def _code_after_closed_output(error: BaseException) -> int:
    """Return the exit code after the output was closed: that of an earlier error, otherwise 0."""
    _discard_output()
    before: BaseException | None = error
    while (before := before.__context__) is not None:
        if isinstance(before, click.Abort | KeyboardInterrupt):
            return CTRL_C
        code = getattr(before, "exit_code", None)
        if isinstance(code, int):
            return code
    return 0


def _ignore_signals() -> None:
    """Ignore signals while the interpreter ends: a second Ctrl-C would replace the exit code."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _discard_output() -> None:
    """Redirect further output to the null device, so that it does not fail when the program ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(nowhere, stream.fileno())


def report_error(error: BaseException) -> int:
    """Write one paragraph about `error` to stderr and return the exit code that belongs to it."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, click.Abort | KeyboardInterrupt):
        # a command that had an arm under power adds its state as a note
        why = str(error) if isinstance(error, StoppedByPerson | click.Abort) and str(error) else "stopped"
        notes = [note.removesuffix(".") for note in getattr(error, "__notes__", [])]
        _say(f"{why}: {'. '.join(notes)}" if notes else why)
        return CTRL_C
    if isinstance(error, click.ClickException):
        error.show()
        return error.exit_code
    code = getattr(error, "exit_code", None)
    if isinstance(code, int):
        _say(f"error: {_message(error)}")
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
    """Write to stderr; ignore a closed terminal."""
    try:
        from gateway.result.numerals import with_degrees

        click.echo(with_degrees(without_controls(text, keep="\n\t")), err=True)
    except (OSError, AttributeError):
        _discard_output()


def _message(error: BaseException) -> str:
    """Return one paragraph, or a line per problem of a file."""
    lines = getattr(error, "lines", ())
    return "\n".join([*lines, *getattr(error, "__notes__", [])]) if lines else paragraph(error)


def paragraph(error: BaseException) -> str:
    """Return the message of an error and its notes on one line, without repetition.

    A note that begins with a capital letter is a separate sentence.
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
        import tempfile  # these two take as long to load as everything else that `--help` needs
        import traceback

        handle, path = tempfile.mkstemp(prefix=f"{PROGRAM}-", suffix=".log")
        with os.fdopen(handle, "w", encoding="utf-8") as log:
            log.write("".join(traceback.format_exception(error)))
    except OSError as failed:
        path = f"no file (it could not be written: {failed})"
    return (
        f"this is a defect of {PROGRAM}: {type(error).__name__}: {paragraph(error)}. "
        f"The details are in {path}; please report them"
    )


@click.group(
    cls=LadderGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.option("-v", "--verbose", count=True, help="More output; twice for all details.")
@click.option("-q", "--quiet", is_flag=True, help="Errors only.")
@click.version_option(__version__, prog_name=PROGRAM)
@click.pass_context
def main(ctx: click.Context, verbose: int, quiet: bool) -> None:
    """CANopen master for six-axis robots: payload mass and centre of gravity, and the cause of the residual.

    New cell: `cell new`, `check`, then `commission`, which leads to the report. COMMAND --help shows examples.
    """
    from gateway.commands.console import Session

    ctx.obj = Session(verbosity=verbose - (1 if quiet else 0))


if __name__ == "__main__":
    main()
