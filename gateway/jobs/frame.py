"""The frame of every command that moves arms, from the opened drives to the options of the first motion.

Every such command locks the bus and opens the drives (`CellContext.opened`, `pair.link.open_link`), and then calls
`begin_motion`: the gate reads every drive, a person is asked about what will happen, the stop of the drives is proven,
and the first motion with these drives is slow.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

from gateway.acquire.events import Listener
from gateway.check.proofs import first_motion_pending, note_motion, prove_now, proven_on, require_proven
from gateway.data.labels import BARE_LABEL
from gateway.errors import InputError
from gateway.jobs.cell_context import CellContext
from gateway.motion.holdtorun import with_held_input
from gateway.motion.opening import OpenArm, frame_log_watched
from gateway.motion.stops import StopDesk, StopSource, signals_ask
from gateway.motion.stream import FIRST_SHARE, MoveOptions
from gateway.motion.workspace import inside_from
from gateway.result.finding import Finding

if TYPE_CHECKING:
    from gateway.acquire.passes import Pass
    from gateway.acquire.plan import Plan
    from gateway.acquire.until import LoadSearch

#: What the question before motion says of the proof of the stop, where it will be made.
FIRST_PROOF: Final = " First, the master's heartbeat is stopped on purpose to prove that the drives stop."
#: What an error at the question adds: the drives are configured by then.
NOT_STARTED: Final = (
    "By this command nothing has moved since the question; the drives keep the settings that were written for this"
    " motion until `servo-gateway restore CELL`."
)
#: What the question says where two arms have drives that have not moved yet.
FIRST_MOTION: Final = (
    " These drives move for the first time, so that this command moves them at {share:.0%} of the speed (not so after"
    " `check --move` with open grippers)."
)
#: What the question says that a test does which moves every joint and proves the stop itself.
LITTLE_MOTION: Final = "will move a little on every joint"
WITHHELD: Final = ", and the master's heartbeat is stopped on purpose (the resulting drive faults are reset)"
#: What the question adds before a test that lets drives and brakes stop the arm.
AT_HAND: Final = " Keep the emergency stop within reach."
#: Asks a person whether arms may move, and raises where the answer is no. The second argument is called again and again
#: until the answer is given, and raises what has changed.
Ask = Callable[[str, Callable[[], None]], None]


def _mount_nothing(label: str, _opened: OpenArm) -> None:
    raise InputError(f"load '{label}' has to be mounted, and no operator was given who mounts it: Operator(mount=..)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Operator:
    """The person at the arm, as functions: what a job asks this person, and what it shows.

    Attributes
    ----------
    ask : callable
        Called with a question about motion, and a function that reads the drives and raises what has changed; it may be
        called until the answer is given. Returns where the answer is yes, and raises where it is no.
    mount : callable
        Called with the label of a load (`none`: an empty flange) and the open arm; returns once the load is mounted.
    support : callable
        Asks for an arm to be supported that is held under power, and does not block. Returns a function that says
        whether the answer was given, or None where no answer can come.
    say : callable
        Shows a remark.
    planned : callable
        Called with the name of an arm, and what it will be measured by: rest poses, a search, or excitations.
    checked : callable
        Shows the findings of a check.
    progress : callable
        Called with the planned duration [s] and the name of a motion; yields the listener of its events.
    working : callable
        Called with the name of a computation; open until that is done.
    """

    ask: Ask
    mount: Callable[[str, OpenArm], None] = _mount_nothing
    support: Callable[[str], Callable[[], bool] | None] = lambda _text: None
    say: Callable[[str], None] = lambda _text: None
    planned: Callable[[str, Plan | LoadSearch | Sequence[Pass]], None] = lambda _arm, _plan: None
    checked: Callable[[Sequence[Finding]], None] = lambda _findings: None
    progress: Callable[[float, str], AbstractContextManager[Listener]] = lambda _s, _name: nullcontext(
        lambda _event: None
    )
    working: Callable[[str], AbstractContextManager[None]] = lambda _name: nullcontext()


@contextmanager
def stoppable(override: float = 1.0, *sources: StopSource) -> Generator[MoveOptions]:
    """Yield the options of motions; meanwhile signals stop a motion along its path, and end the job without one.

    A requested stop is kept: motions with the same options end at once. Open it again for the next job.

    Parameters
    ----------
    override : float
        Speed override in (0, 1].
    *sources : callable
        Further sources of stop requests.
    """
    desk = StopDesk(*sources)
    with signals_ask(desk):
        yield MoveOptions(desk, override)


def flange_question(load: str | None) -> str:
    """Return what the question adds where the first load to be measured is that of the unloaded arm."""
    return " Is the flange empty?" if load == BARE_LABEL else ""


def ask_to_move(
    context: CellContext,
    opened: Sequence[OpenArm],
    operator: Operator,
    what: str,
    before: Callable[[], None] = lambda: None,
) -> None:
    """Ask whether arms may move, after all was read that power needs; the drives are read further until the answer.

    Parameters
    ----------
    context : CellContext
    opened : sequence of OpenArm
    operator : Operator
    what : str
        What the arms will do, as a sentence that follows their names; further sentences and questions may follow it.
    before : callable
        Called before the question; not where an arm is refused.

    Raises
    ------
    DriveError, SeveralFailures
        An arm cannot be enabled, or is not safe to approach; no question was asked.
    PlanRefused
        An arm is in a posture from which it may not move; no question was asked.
    """
    for each in opened:
        each.group.gate(full=True).require_power()
        inside_from(each.workspace, each.arm.where(), each.config.name)

    def attend() -> None:
        for each in opened:
            each.group.attend()

    names = " and ".join(f"'{each.config.name}'" for each in opened)
    arms = f"Arm {names}" if len(opened) == 1 else f"Arms {names}"
    # one arm of a pair moves alone only where no part holds it
    cell = context.loaded.cell
    grippers = " Are both grippers open?" if len(opened) == 1 and cell.pair is not None else ""
    before()
    try:
        operator.ask(f"{arms} of cell '{cell.name}' {what}{grippers} Is the area clear of people?", attend)
    except BaseException as error:
        error.add_note(NOT_STARTED)
        raise


def begin_motion(
    context: CellContext,
    opened: Sequence[OpenArm],
    options: MoveOptions,
    operator: Operator,
    *,
    what: str = "will move",
    also: str = "",
    proof: Literal["made", "stored", "own"] = "made",
) -> MoveOptions:
    """Ask whether arms may move, prove the stop of their drives, and return the options of their motions.

    Parameters
    ----------
    context : CellContext
    opened : sequence of OpenArm
        Connected and configured, brakes on.
    options : MoveOptions
    operator : Operator
    what : str
        What the arms will do, after their names.
    also : str
        Further sentences and questions, each with a space before it.
    proof : str
        'made': the stop of the drives is proven first, unless a proof is stored that is valid. 'stored': without one
        nothing moves, because two arms hold one part. 'own': the command itself proves the stop, and says so in `what`.

    Raises
    ------
    FindingFailed
        A drive does not stop on loss of the master, or that is not proven.
    DriveError, SeveralFailures, PlanRefused, KeyboardInterrupt
        As `ask_to_move` and `prove_now`.
    """
    arms = [(context.stop_proof(each.config), each) for each in opened]
    new = [(path, each) for path, each in arms if first_motion_pending(path, each)]
    for path, each in arms:
        if proof == "stored":
            require_proven(each, path, options.override)
        elif proof == "made" and proven_on(path, each, options.override) is None:
            also = FIRST_PROOF + also
    if proof == "stored" and new:  # no short motion tries two arms that hold a part: the whole command is slow
        options = replace(options, override=min(FIRST_SHARE, options.override))
        also = FIRST_MOTION.format(share=options.override) + also
    ask_to_move(context, opened, operator, f"{what}.{also}", options.before_question)
    for each in opened:
        options = with_held_input(each, options)
        options.desk.watch(frame_log_watched(each))
    if proof == "made":
        for path, each in arms:
            proven = proven_on(path, each, options.override)
            if proven is not None:
                operator.say(f"drives stop on loss of the master: proven {proven}")
                continue
            with context.last_seconds(options, each):
                prove_now(each, path, operator.say, options)

    def note() -> None:
        for path, each in new:
            note_motion(path, each)

    return replace(options, first_done=note) if new else options
