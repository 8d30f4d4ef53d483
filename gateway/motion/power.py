"""Enable arms for a motion, and leave them at rest with their brakes applied in every case."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Final

from drives.errors import DriveError
from drives.realtime import RealTime
from gateway.errors import LimitExceeded
from gateway.motion.arms import Arms
from gateway.motion.state import Phase
from gateway.motion.stream import Stream

#: A joint that moves farther once its brake has closed is reported [rad].
BRAKE_DROP_RAD: Final = 0.005


@contextmanager
def _on_time(arms: Arms) -> Generator[None]:
    """Request real-time scheduling for the motion loop, in real time only."""
    if not arms.real:
        yield
        return
    with RealTime():
        yield


@contextmanager
def powered(stream: Stream) -> Generator[Stream]:
    """Enable the arms at their present positions; on every exit they are at rest with their brakes on.

    The stop depends on the cause. After a stop along the path the arms are already at rest. While setpoints are being
    sent, and after an error of a drive or of a limit, all axes are stopped by their quick stop ramps at once. An
    unconfirmed stop ends the heartbeat (`drives.stopping`). Observers are notified afterwards.

    Raises
    ------
    DriveError, LimitExceeded, KeyboardInterrupt
        The cause that ended the motion, once the arms are safe; failures while stopping are in its notes.
    """
    station = stream.station
    desk, observers = station.options.desk, station.options.observers
    failure: BaseException | None = None
    station.options.ready()
    with _on_time(station.arms):
        try:
            desk.under_power = True
            observers.began(station.scene)
            stream.start()
            station.state.enter(Phase.HOLDING, stream.sync_index)
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
                _report_end(stream, failure)
                observers.ended(failure)
            if stream.first_moved and station.options.first_done is not None:
                station.options.first_done()
    wish = desk.look()
    if wish is not None:
        raise wish.cause


def _make_safe(stream: Stream, failure: BaseException | None) -> None:
    arms = stream.station.arms
    quick = stream.moving or stream.urgent or isinstance(failure, DriveError | LimitExceeded)
    try:
        if quick:
            _attempt(arms.quick_stop, failure)
    finally:
        _attempt(arms.disable, failure)


def _attempt(action: Callable[[], None], failure: BaseException | None) -> None:
    try:
        action()
    except Exception as error:
        if failure is None:
            raise
        failure.add_note(f"while stopping: {error}")


def _report_end(stream: Stream, failure: BaseException | None) -> None:
    state = stream.station.state
    state.enter(Phase.STOPPING, stream.sync_index)
    since = state.state
    drop_text = _brake_drop_text(stream)
    if failure is None:
        state.enter(Phase.IN_BRAKES, stream.sync_index, drop_text)
        return
    if drop_text:
        failure.add_note(drop_text)
    failure.add_note(f"Stopped at {since.since:%H:%M:%S} UTC, SYNC {since.sync_index} of this run.")
    state.enter(Phase.STOPPED, stream.sync_index, str(failure) or type(failure).__name__)


def _brake_drop_text(stream: Stream) -> str:
    """Return the text about joints that have dropped after the brakes were applied."""
    found = []
    for arm in stream.station.arms.members:
        brake_drop_rad = arm.brake_drop_rad()
        found += [
            f"arm '{arm.name}', joint {joint} sank by {value:.4f} rad in its brake"
            for joint, value in enumerate(brake_drop_rad.tolist(), start=1)
            if value > BRAKE_DROP_RAD
        ]
    return "; ".join(found) + ("; check its brake and the brake's delay" if found else "")
