"""Terminal output: tables, notes, progress with remaining time. Nothing is computed here."""

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
from gateway.result.numerals import SAID, with_degrees, with_interval

if TYPE_CHECKING:
    from gateway.result.result import Finding, Result

SEVERITY_STYLE = {"fail": "bold red", "warn": "yellow", "warning": "yellow", "ok": "green", "pass": "green"}
PLAIN_WIDTH = 140


class _Terminal(Console):
    """Console for the terminal.

    Control characters are removed. A closed pipe raises an error; rich would exit at once, even while arms move.
    """

    def render(self, renderable: Any, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as rich does, without control characters in names from drives and files."""
        for each in super().render(renderable, options):
            yield each if each.control else Segment(without_controls(each.text, keep="\n\t"), each.style)

    def on_broken_pipe(self) -> None:
        """Raise an error when the reader has closed the pipe."""
        raise BrokenPipeError(errno.EPIPE, "the terminal was closed")


class _PlainFormatter(logging.Formatter):
    """Log formatter that removes control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return without_controls(super().format(record), keep="\n\t")


@dataclass(slots=True)
class Session:
    """Settings of the output.

    Parameters
    ----------
    verbosity : int
        -1 errors only, 0 normal, 1 and more details.
    data_on_stdout : bool
        True when stdout carries JSON, so that tables go to stderr.
    """

    verbosity: int = 0
    data_on_stdout: bool = False
    _consoles: dict[bool, Console] = field(default_factory=dict)
    _outlets: dict[bool, Outlet] = field(default_factory=dict)

    def console(self, *, err: bool = False) -> Console:
        """Return the console of stdout (or stderr); the width is that of the terminal, or fixed for files and pipes."""
        if err not in self._consoles:
            stream = sys.stderr if err else sys.stdout
            width = None if stream.isatty() or "COLUMNS" in os.environ else PLAIN_WIDTH
            outlet: Any = Outlet(stream)
            self._outlets[err] = outlet
            self._consoles[err] = _Terminal(file=outlet, width=width, highlight=False, soft_wrap=False)
        return self._consoles[err]

    @contextmanager
    def detached(self) -> Generator[None]:
        """Queue all output while arms may move, so that a blocked terminal delays nothing."""
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
        """Wait until all output is written, before a prompt; not to be called during motion."""
        for outlet in self._outlets.values():
            outlet.settle()

    def show(self, item: Any) -> None:
        """Print a table or a line of the result without markup: square brackets are units.

        Lines are not wrapped, so that paths and phrases stay searchable.
        """
        if self.verbosity >= 0:
            text = with_degrees(item) if isinstance(item, str) else item
            self.console(err=self.data_on_stdout).print(text, markup=False, soft_wrap=isinstance(item, str))

    def note(self, text: str, level: int = 0) -> None:
        """Print a note to stderr, without wrapping."""
        if self.verbosity >= level:
            self.console(err=True).print(with_degrees(text), markup=False, soft_wrap=True)

    @contextmanager
    def progress(self, total: float, text: str) -> Generator[Bar]:
        """Show progress with remaining time on stderr: a bar on a terminal, otherwise a line every 10 %.

        `total` is the duration of a motion [s]; 0 where nothing moves.
        """
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
        """Show an activity indicator on stderr during a computation; nothing without a terminal."""
        console = self.console(err=True)
        if self.verbosity < 0 or not console.is_terminal:
            yield
        else:
            with console.status(text):
                yield


class Bar:
    """Progress without output."""

    def set(self, done: float, total: float, what: str) -> None:
        """Report the amount done, the total, and the current step."""


class RichBar(Bar):
    """Progress bar of a terminal."""

    def __init__(self, progress: Progress, task: TaskID, text: str) -> None:
        self._progress, self._task, self._text = progress, task, text

    def set(self, done: float, total: float, what: str) -> None:
        """Update the bar."""
        self._progress.update(self._task, completed=done, total=total, description=f"{self._text}: {what}")


class LineBar(Bar):
    """Progress as a line of text every 10 %."""

    def __init__(self, session: Session, text: str, total: float) -> None:
        self._session, self._text, self._tenth = session, text, 0
        self._began_s = time.monotonic()
        if total > 0:
            session.note(f"{text}: about {total:.0f} s of motion")

    def set(self, done: float, total: float, what: str) -> None:
        """Print a line when another 10 % is done."""
        share = done / total if total > 0 else 1.0
        if int(10 * share) > self._tenth:
            self._tenth = int(10 * share)
            left_s = (time.monotonic() - self._began_s) * (1 - share) / share
            self._session.note(f"{self._text}: {100 * share:.0f} %, {left_s:.0f} s left ({what})")


def grid(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> Table:
    """Return a table with `left` text columns followed by right-aligned ones."""
    text = escape(title)  # rich interprets markup in the title even when printing without markup
    table = Table(title=text, title_justify="left", title_style="bold", header_style="bold", box=box.SIMPLE_HEAD)
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def number(value: float | None, digits: int = 2) -> str:
    """Format a number with fixed decimals; a dash for a missing one."""
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def axis_names(axes: int) -> list[str]:
    """J1 to JN."""
    return [f"J{axis}" for axis in range(1, axes + 1)]


def load_table(result: Result) -> Table:
    """Return a table of mass and centre of gravity of each load, with half widths of the 95 % intervals."""
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
    return grid(f"payload: value ± half of the {SAID} interval", columns, rows, left=4)


def _with_interval(value: float, std: float, factor: float) -> str:
    return "not identifiable" if math.isnan(value) else with_interval(value, std, factor)


def _vector(values: Sequence[float] | None, stds: Sequence[float] | None) -> str:
    if values is None:
        return "-"
    spread = (math.nan,) * len(values) if stds is None else stds
    return "  ".join(_with_interval(value, std, 1000.0) for value, std in zip(values, spread, strict=True))


def axis_table(title: str, lines: Mapping[str, Sequence[float]]) -> Table:
    """Return a table with one row per quantity and one column per axis."""
    rows = [[name, *(number(value, 3) for value in values)] for name, values in lines.items()]
    return grid(title, ["", *axis_names(max((len(row) - 1 for row in rows), default=0))], rows)


def findings_table(findings: Sequence[Finding], title: str = "findings") -> Table:
    """Return a table of findings with their remedies, equal ones of several axes in one row; severity is coloured."""
    table = grid(title, ["severity", "where", "what", "advice"], [], left=4)
    rows: dict[tuple[str, ...], list[str]] = {}
    for finding in findings:
        place, colon, address = finding.where.partition(":")
        rows.setdefault((finding.severity, colon + address, finding.what, finding.advice), []).append(place)
    for (severity, address, what, advice), places in rows.items():
        coloured = Text(severity, style=SEVERITY_STYLE.get(severity, "default"))
        table.add_row(coloured, ", ".join(places) + address, with_degrees(what), with_degrees(advice))
    return table
