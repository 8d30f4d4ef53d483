"""Common parts of commands that move an arm: options, stop sources and the confirmation before motion."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import click

from gateway.commands.shared_options import Function, confirm, session_of

if TYPE_CHECKING:
    from gateway.motion.stream import MoveOptions

FULL_PERCENT: Final = 100


@dataclass(frozen=True, slots=True)
class MoveChoice:
    """The options MOVE of the command line.

    Attributes
    ----------
    override : int
        Speed override, percent.
    hold_to_run : bool
        Arms move only while a key is held.
    yes : bool
        Do not ask before moving.
    pacing : str or None
        Overrides that of the cell.
    live : bool
        Show the live page.
    """

    override: int
    hold_to_run: bool
    yes: bool
    pacing: str | None
    live: bool = False

    def ask(self, question: str, meanwhile: Callable[[], None]) -> None:
        """Ask for confirmation before motion; no answer means no. At a terminal `meanwhile` is called until then."""
        if not self.yes:
            confirm(question, "declined", meanwhile)


#: Names of the options.
MOVE: Final = tuple(each.name for each in fields(MoveChoice))


def move_options(function: Function, percent: int = FULL_PERCENT) -> Function:
    """Add MOVE: --override, --hold-to-run, --yes, --pacing, --live; the command takes them as one argument `moving`.

    A closed terminal stops the command like Ctrl-C, also before motion. `percent` is the default override.
    """

    def gathered(*arguments: Any, **named: Any) -> Any:
        from gateway.motion.stops import CLOSED, StoppedByPerson, output_closed

        moves = _moves(named)
        named["hold_to_run"] &= moves
        choice = MoveChoice(**{name: named.pop(name) for name in MOVE})
        try:
            return function(*arguments, moving=choice, **named)
        except (OSError, SystemExit) as error:
            if output_closed(error) and moves:
                raise StoppedByPerson(CLOSED) from error
            raise

    gathered.__name__, gathered.__doc__ = function.__name__, function.__doc__
    gathered.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
    wrapped: Callable[..., Any] = gathered
    for option in (
        click.option(
            "--live", is_flag=True, help="Show the live page in a browser on this computer; the address is printed."
        ),
        click.option("--yes", is_flag=True, help="Do not ask before moving."),
        click.option(
            "--pacing",
            type=click.Choice(["lockstep", "real"]),
            help="Overrides that of the cell; lockstep only with the simulator.",
        ),
        click.option("--hold-to-run", is_flag=True, help="Move only while a key is held (no enabling device)."),
        click.option(
            "--override",
            type=click.IntRange(1, 100),
            default=percent,
            show_default=True,
            metavar="PERCENT",
            help="Speed override.",
        ),
    ):
        wrapped = option(wrapped)
    return wrapped  # type: ignore[return-value]


def _moves(named: Mapping[str, Any]) -> bool:
    """Return whether motion was requested: `check` moves only with its motion options, no command with data."""
    asked = [named[flag] for flag in ("move", "prove_stop", "brakes", "timing") if flag in named]
    return not named.get("data") and (not asked or any(asked))


@contextmanager
def stoppable(move: MoveChoice) -> Generator[MoveOptions]:
    """While open, signals and the hold-to-run key stop the motion; without motion the command ends at once.

    Output is queued meanwhile, so that a blocked terminal delays no SYNC.
    """
    from gateway.jobs.frame import stoppable as stopped_by_signals
    from gateway.motion.holdtorun import held_key
    from gateway.motion.stops import outputs_watched

    with ExitStack() as stack:
        options = stack.enter_context(stopped_by_signals(move.override / 100.0, outputs_watched()))
        desk, observers = options.desk, options.observers
        stack.enter_context(session_of().detached())

        def show_page() -> None:
            from gateway.live.page import LivePage

            page = stack.enter_context(LivePage(f"servo-gateway {click.get_current_context().info_name}"))
            desk.watch(page.feed.pressed)
            session_of().note(f"live page: {page.address}")
            observers.add(page.feed)

        if move.live:
            options = replace(options, before_question=show_page)
        if move.hold_to_run:
            key = stack.enter_context(held_key())
            desk.watch(lambda: key() if desk.under_power else None)

            def ready() -> None:
                session_of().note("hold the space bar: the arm moves only while it is held")
                key.wait()

            options = replace(options, ready=ready)
        yield options


def support_asked(move: MoveChoice) -> Callable[[str], Callable[[], bool] | None]:
    """Return the prompt to support an arm that is held under power; it does not block the motion loop."""

    from gateway.motion.holdtorun import line_entered

    def ask(text: str) -> Callable[[], bool] | None:
        if move.hold_to_run:
            session_of().note(f"{text} Then let go of the key.", -1)
            return lambda: False
        if move.yes or sys.stdin is None or not sys.stdin.isatty():
            session_of().note(f"{text} This happens after some seconds, without confirmation.", -1)
            return None
        session_of().note(f"{text} Then press Enter.", -1)
        return line_entered(sys.stdin.fileno())

    return ask
