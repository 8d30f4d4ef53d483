"""Enable arms for a motion, and leave them at rest with their brakes applied in every case."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager, nullcontext
from typing import Final

from drives.errors import BrakeDropped, DriveError, NotStoodDown
from drives.gate import ArmState
from drives.realtime import RealTime
from gateway.errors import LimitExceeded
from gateway.motion.state import Phase
from gateway.motion.stream import Stream

#: A joint that moves farther once its drive is disabled is an error: its brake does not hold [rad].
BRAKE_DROP_RAD: Final = 0.005
_KEEP_AWAY: Final = (
    "keep away from this arm: no person mounts a load or works at it; support it mechanically, then check these brakes"
    " and brake_closing_s of the drive profile (test: `servo-gateway check CELL --brakes`)"
)


@contextmanager
def powered(stream: Stream) -> Generator[Stream]:
    """Enable the arms at their present positions; on every exit they are at rest with their brakes on.

    The stop depends on the cause. After a stop along the path the arms are already at rest. While setpoints are being
    sent, and after an error of a drive or of a limit, all axes are stopped by their quick stop ramps at once. An
    unconfirmed stop ends the heartbeat (`drives.stopping`). Then the gate reads every drive, and observers are
    notified; the phase is `Phase.UNKNOWN` unless every drive was read as disabled.

    Raises
    ------
    BrakeDropped
        A joint dropped after its drive was disabled, also where the motion has ended without error or was stopped on
        request.
    DriveError
        A drive restarted, moved, or sent an emergency since it was disabled.
    DriveError, LimitExceeded, KeyboardInterrupt
        The cause that ended the motion; failures while stopping are in its notes.
    """
    arms, options, desk, observers = stream.arms, stream.options, stream.options.desk, stream.options.observers
    failure: BaseException | None = None
    options.ready()
    with RealTime() if arms.real else nullcontext():
        try:
            desk.under_power = True
            observers.notify(lambda each: each.began(arms, stream.workspaces, stream.period_s, stream.state))
            stream.start()
            stream.state.enter(Phase.HOLDING, stream.sync_index)
            yield stream
        except BaseException as error:
            failure = error
            raise
        finally:
            try:
                _make_safe(stream, failure)
            except BaseException as error:
                failure = failure or error
                raise
            finally:
                desk.under_power = False
                state = arms.gate()
                changed: DriveError | None = _brake_dropped(stream, failure)
                if changed is None and failure is None:
                    try:
                        state.require_approach()
                    except DriveError as error:
                        changed = error
                failure = changed or failure
                _report_end(stream, failure, state)
                observers.notify(lambda each: each.ended(failure))
                if changed is not None:
                    raise changed
            if stream.first_moved and options.first_done is not None:
                options.first_done()
    wish = desk.look()
    if wish is not None:
        raise wish.cause


def _make_safe(stream: Stream, failure: BaseException | None) -> None:
    """Stop and disable the arms; an error of this becomes a note of an earlier failure."""
    arms = stream.arms
    quick = stream.moving or stream.urgent or isinstance(failure, DriveError | LimitExceeded)
    for action in (arms.quick_stop, arms.disable) if quick else (arms.disable,):
        try:
            action()
        except Exception as error:
            if failure is None:
                raise
            failure.add_note(f"{'after the stop' if isinstance(error, NotStoodDown) else 'while stopping'}: {error}")


def _report_end(stream: Stream, failure: BaseException | None, state: ArmState) -> None:
    """Report the phase that the drives were read in."""
    tracker = stream.state
    tracker.enter(Phase.STOPPING, stream.sync_index)
    since = tracker.state
    if failure is None:
        tracker.enter(Phase.IN_BRAKES, stream.sync_index)
        return
    failure.add_note(f"The motion ended at {since.since:%H:%M:%S} UTC, SYNC {since.sync_index} of this run.")
    if not state.is_disabled:
        failure.add_note(f"{state}.")
    phase = Phase.STOPPED if state.is_disabled else Phase.UNKNOWN
    tracker.enter(phase, stream.sync_index, str(failure) or type(failure).__name__)


def _brake_dropped(stream: Stream, failure: BaseException | None) -> BrakeDropped | None:
    """Return the error for joints that have dropped since their drives were disabled.

    An error of a drive stays the cause; the drop is then among its notes.
    """
    drops = [
        f"arm '{arm.name}', joint {joint} sank by {value:.4f} rad in its brake after its drive was disabled"
        for arm in stream.arms.members
        for joint, value in enumerate(arm.brake_drop_rad().tolist(), start=1)
        if value > BRAKE_DROP_RAD
    ]
    if not drops:
        return None
    dropped = BrakeDropped("; ".join(drops), advice=_KEEP_AWAY)
    if isinstance(failure, DriveError):
        failure.add_note(str(dropped))
        return None
    if failure is not None:
        dropped.add_note(f"The motion had ended before: {str(failure) or type(failure).__name__}")
        for note in getattr(failure, "__notes__", ()):
            dropped.add_note(note)
    return dropped
