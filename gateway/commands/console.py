"""What the person at the terminal sees: tables, notes, progress with remaining time. Nothing is computed here."""

from __future__ import annotations

import errno
import logging
import math
import os
import sys
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console, ConsoleOptions
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from drives.printable import without_controls
from gateway.commands.output_queue import Outlet
from gateway.result.interval import SAID
from gateway.result.numerals import with_degrees, with_interval

if TYPE_CHECKING:
    from gateway.result.result import Finding, Result

SEVERITY_STYLE = {"fail": "bold red", "warn": "yellow", "warning": "yellow", "ok": "green", "pass": "green"}
PLAIN_WIDTH = 140


class _Terminal(Console):
    """The one output to the terminal.

    What is printed cannot control the terminal; a closed pipe is an error like any other, where rich would end the
    program at once, arms or not.
    """

    def render(self, renderable: Any, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as rich does, without the control characters of names that come from drives and files."""
        for each in super().render(renderable, options):
            yield each if each.control else Segment(without_controls(each.text, keep="\n\t"), each.style)

    def on_broken_pipe(self) -> None:
        """Nobody reads any more."""
        raise BrokenPipeError(errno.EPIPE, "the terminal was closed")


class _PlainFormatter(logging.Formatter):
    """Log lines that cannot control the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return without_controls(super().format(record), keep="\n\t")


@dataclass(slots=True)
class Session:
    """How much to say, and where.

    Parameters
    ----------
    verbosity : int
        -1 errors only, 0 normal, 1 and more details.
    data_on_stdout : bool
        True when stdout carries JSON, so that tables go to stderr.
    replaces : bool
        True when files that are there may be replaced.
    in_degrees : bool
        True when joint angles are typed in degrees.
    """

    verbosity: int = 0
    data_on_stdout: bool = False
    replaces: bool = False
    in_degrees: bool = False
    _consoles: dict[bool, Console] = field(default_factory=dict)
    _outlets: dict[bool, Outlet] = field(default_factory=dict)

    def console(self, *, err: bool = False) -> Console:
        """Console for stdout (or stderr), as wide as the terminal, wide enough for a table elsewhere."""
        if err not in self._consoles:
            stream = sys.stderr if err else sys.stdout
            width = None if stream.isatty() or "COLUMNS" in os.environ else PLAIN_WIDTH
            outlet: Any = Outlet(stream)
            self._outlets[err] = outlet
            self._consoles[err] = _Terminal(file=outlet, width=width, highlight=False, soft_wrap=False)
        return self._consoles[err]

    @contextmanager
    def detached(self) -> Generator[None]:
        """While arms may move: whatever is printed or logged is queued, and a terminal that hangs delays nothing."""
        with ExitStack() as stack:
            for err in (False, True):
                self.console(err=err)
                stack.enter_context(self._outlets[err].detached())
            errors: Any = self._outlets[True]
            log = logging.StreamHandler(errors)
            log.setLevel(logging.WARNING)
            log.setFormatter(_PlainFormatter())
            logging.getLogger().addHandler(log)
            stack.callback(logging.getLogger().removeHandler, log)
            yield

    def settle(self) -> None:
        """Wait until all that was printed is written, before a person is asked; not while anything moves."""
        for outlet in self._outlets.values():
            outlet.settle()

    def show(self, item: Any) -> None:
        """Print a table or a line of the answer, as it stands: square brackets are units.

        A line is left whole, whatever the width: a path or a phrase in it can be found, and a terminal folds it itself.
        """
        if self.verbosity >= 0:
            told = with_degrees(item) if isinstance(item, str) else item
            self.console(err=self.data_on_stdout).print(told, markup=False, soft_wrap=isinstance(item, str))

    def note(self, text: str, level: int = 0) -> None:
        """Print a remark to stderr, left whole as every line."""
        if self.verbosity >= level:
            self.console(err=True).print(with_degrees(text), markup=False, soft_wrap=True)

    @contextmanager
    def progress(self, total: float, text: str) -> Generator[Bar]:
        """Progress with remaining time on stderr: a bar on a terminal, a line per tenth elsewhere."""
        console = self.console(err=True)
        if self.verbosity < 0:
            yield Bar()
        elif not console.is_terminal:
            yield LineBar(self, text, total)
        else:
            columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
            with Progress(*columns, console=console, transient=True) as progress:
                yield RichBar(progress, progress.add_task(text, total=total), text)

    @contextmanager
    def working(self, text: str) -> Generator[None]:
        """A sign of life on stderr while something is computed; nothing where there is no terminal."""
        console = self.console(err=True)
        if self.verbosity < 0 or not console.is_terminal:
            yield
        else:
            with console.status(text):
                yield


class Bar:
    """Progress that shows nothing."""

    def set(self, done: float, total: float, what: str) -> None:
        """Say how much is done, of how much, and what is being done."""


class RichBar(Bar):
    """Progress bar of a terminal."""

    def __init__(self, progress: Progress, task: TaskID, text: str) -> None:
        self._progress, self._task, self._text = progress, task, text

    def set(self, done: float, total: float, what: str) -> None:
        """Move the bar."""
        self._progress.update(self._task, completed=done, total=total, description=f"{self._text}: {what}")


class LineBar(Bar):
    """A line of text for every tenth."""

    def __init__(self, session: Session, text: str, total: float) -> None:
        self._session, self._text, self._tenth = session, text, 0
        self._began_s = time.monotonic()
        session.note(f"{text}: about {total:.0f} s of motion")

    def set(self, done: float, total: float, what: str) -> None:
        """Say so when another tenth is done."""
        share = done / total if total > 0 else 1.0
        if int(10 * share) > self._tenth:
            self._tenth = int(10 * share)
            left_s = (time.monotonic() - self._began_s) * (1 - share) / share
            self._session.note(f"{self._text}: {100 * share:.0f} %, {left_s:.0f} s left ({what})")


def grid(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> Table:
    """Table with `left` text columns followed by right-aligned ones."""
    text = escape(title)  # printing without markup spares headers and cells, not the title
    table = Table(title=text, title_justify="left", title_style="bold", header_style="bold", box=box.SIMPLE_HEAD)
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def number(value: float | None, digits: int = 2) -> str:
    """A number with fixed decimals, or a dash where there is none."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def axis_names(axes: int) -> list[str]:
    """J1 to JN."""
    return [f"J{axis}" for axis in range(1, axes + 1)]


def load_table(result: Result) -> Table:
    """Mass and centre of gravity of each load, half of its 95 % interval behind each number."""
    turned = {} if result.data is None else result.data.flange
    rows = []
    for load in result.loads:
        if load.refused:
            rows.append([load.label, "refused", load.refused, ""])
            continue
        in_flange = turned.get(load.label)
        rows.append(
            [
                load.label,
                _with_interval(load.mass_kg, load.mass_std_kg, 1.0),
                _vector(load.com_m, load.com_std_m),
                _vector(load.com_flange_m, None if in_flange is None else in_flange.com_std_m),
            ]
        )
    frame = result.loads[0].frame if result.loads else "link_6"
    columns = ["load", "mass [kg]", f"centre of gravity in {frame} [mm]", "in the flange frame [mm]"]
    return grid(f"load: value ± half of the {SAID} interval", columns, rows, left=4)


def _with_interval(value: float, std: float, factor: float) -> str:
    return "not identifiable" if math.isnan(value) else with_interval(value, std, factor)


def _vector(values: Sequence[float] | None, stds: Sequence[float] | None) -> str:
    if values is None:
        return "-"
    spread = (math.nan,) * len(values) if stds is None else stds
    return "  ".join(_with_interval(value, std, 1000.0) for value, std in zip(values, spread, strict=True))


def axis_table(title: str, lines: Mapping[str, Sequence[float]]) -> Table:
    """One row per quantity, one column per axis."""
    rows = [[name, *(number(value, 3) for value in values)] for name, values in lines.items()]
    return grid(title, ["", *axis_names(max((len(row) - 1 for row in rows), default=0))], rows)


def findings_table(findings: Sequence[Finding], title: str = "findings") -> Table:
    """Findings with their advice; the severity in colour."""
    table = grid(title, ["severity", "where", "what", "advice"], [], left=4)
    for finding in findings:
        severity = Text(finding.severity, style=SEVERITY_STYLE.get(finding.severity, "default"))
        table.add_row(severity, finding.where, with_degrees(finding.what), with_degrees(finding.advice))
    return table
