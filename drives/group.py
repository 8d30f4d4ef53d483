"""The drives of one arm under one SYNC: found, configured, enabled, moved, stopped, put back.

Nothing is automatic: no fault is reset, no axis is enabled, homed or stored without being told to. When an axis leaves
OPERATION ENABLED by itself, stops answering, boots or falls silent, every axis is stopped before the error is raised.

While axes are enabled, `exchange` or `hold` has to be called again before the drives' heartbeat time is over: the
heartbeat of the master is sent from there, so that a master that hangs stops the arm as a dead one does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Final

from drives import bringup, operational, starting, stopping
from drives.cia402 import Mode
from drives.drive import DriveCommand
from drives.epoch import Epoch
from drives.errors import (
    ConfigurationRefused,
    DriveError,
    DriveRebooted,
    SdoTimeout,
    raise_failures,
    while_stopping,
)
from drives.exchange import SyncExchange
from drives.group_setup import DriveSetup, GroupOptions
from drives.guard import Guard
from drives.heartbeat import NmtCommand, send_nmt
from drives.proof import StopTrace, fall_silent, watch_quick_stop, watch_released
from drives.way_up import WayUp

__all__ = ["DriveGroup", "GroupOptions"]

#: Longest wait for axes that are told to hold to stand.
_REST_S: Final = 1.0


class DriveGroup(DriveSetup):
    """Drives that follow one SYNC; parameters as `DriveSetup`.

    An error that `exchange`, `hold` or a proof raises has stopped all axes by their quick stop ramps, as far as that
    was possible; they are under power as the drives decide, and `disable` or `close` is still to be called. Where a
    stop is not confirmed, the master's heartbeat has ended, and the drives have to be found and configured again before
    they can be enabled.
    """

    #: Motor angle of each axis from where it was last held to the farthest place after it was disabled; 0.0 = unknown.
    sag_rad: tuple[float, ...] = ()

    # -- moving ------------------------------------------------------------------------------------------------------

    def enable(self, stop_asked: Callable[[], bool] = lambda: False) -> Epoch:
        """Bring every axis to OPERATION ENABLED, where it holds the position it is at.

        Parameters
        ----------
        stop_asked : callable
            Asked at every SYNC until the brakes are open: whether a person wants to stop.

        Returns
        -------
        Epoch
            The last one; complete, every axis enabled.

        Raises
        ------
        DriveFault, NotOperational, TransitionTimeout, IncompleteEpochs, SeveralFailures
            What failed; all axes are disabled again. A drive in FAULT is refused and never reset, one that falls back
            on the way up is not led up again.
        StopAsked
            All axes are disabled again.
        """
        exchange, guard = self._parts()
        self._require(self._configured and not self.enabled, "configure() first, and enable() once")
        self._for_each(lambda drive: starting.refuse_fault(drive, guard))
        self._for_each(starting.refuse_unsafe)
        try:
            self._for_each(starting.refuse_lost_configuration)
        except Exception:
            self._configured = False
            raise
        way = WayUp(exchange, guard, stop_asked)
        way.check_stop()
        try:
            return self._enable(exchange, guard, way)
        except BaseException as error:
            self._after(error, stopping.disable)
            raise

    def _enable(self, exchange: SyncExchange, guard: Guard, way: WayUp) -> Epoch:
        self._for_each(lambda drive: drive.arm(self._master_node_id))
        guard.forgive()
        self._bus.free_count = None  # from now on the guard watches for other masters
        exchange.restart()
        self._producer.start(exchange.sync_time_s)
        self._running = True
        epoch = self._start_nodes(exchange, guard, way)
        guard.forgive_cleared()  # a node may say why it refuses START, and that it does no more
        readings = {reading.node_id: reading for reading in epoch.readings if reading is not None}
        self._for_each(lambda drive: starting.compare_with_sdo(drive, readings[drive.node_id]))
        exchange.clock.restart()
        epoch = way.walk(starting.first_epoch(exchange))
        for drive in self.drives:
            if not drive.setup.profile.state_machine.mode_before_enable:
                bringup.check_mode(drive.access, Mode.CYCLIC_SYNC_POSITION)
        self.enabled = True
        for _ in range(math.ceil(way.brake_s / self.timing.period_s)):
            epoch = self.hold()
            way.check(epoch)
        while not epoch.complete:
            epoch = self.hold()
            way.check(epoch)
        return epoch

    def _start_nodes(self, exchange: SyncExchange, guard: Guard, way: WayUp) -> Epoch:
        """NMT START, confirmed by every drive; the first row in which all of them answer."""
        watch = self._watch
        if watch is None:
            raise ConfigurationRefused("the drives are not configured", advice="connect() and configure() first")
        start = operational.NmtStart(self._bus, self.drives, self.instruments, watch, guard)
        start.begin()
        start.confirm(way.check_stop)
        exchange.clock.restart()
        return starting.first_epoch(exchange, lambda epoch: way.check_stop() or start.again(epoch))

    def exchange(self, commands: Sequence[DriveCommand]) -> Epoch:
        """One SYNC: send a target to every axis, gather what every axis measured at this SYNC.

        Parameters
        ----------
        commands : sequence of DriveCommand
            One per axis, motor side.

        Returns
        -------
        Epoch
            Complete, or marked incomplete.

        Raises
        ------
        CommandRefused
            A target outside the limits; nothing was sent, and the axes stand where they were told to before.
        DriveFault, DriveRebooted, HeartbeatLost, IncompleteEpochs, ForeignMaster, BusError, SeveralFailures
            All axes have been stopped.
        MasterStalled
            By the clock: the axes move and this computer was held up. These targets were not sent; all axes have been
            stopped. Where nothing moved, the row of a late SYNC is incomplete and nothing else happens.
        """
        self._stage(commands)
        return self._cycle()

    def hold(self) -> Epoch:
        """One SYNC with the last commanded positions and no torque offset; raises as `exchange`."""
        self._stage(None)
        return self._cycle()

    def _stage(self, commands: Sequence[DriveCommand] | None) -> None:
        if not self.enabled:
            self._require(False, "enable() first")
        if commands is None:
            for drive in self.drives:
                drive.hold(drive.target_count)
            return
        for drive, command in zip(self.drives, commands, strict=True):
            drive.stage(command)

    def begin(self, commands: Sequence[DriveCommand] | None) -> None:
        """By the clock, first part of a SYNC that several groups share: targets out; raises as `exchange`.

        Then, in the same thread and for all groups before the next part: `prepare`, `sync`, `gather` and `check`. If
        anything fails, or is not done, the groups that have begun are to be told to `abandon`.

        Parameters
        ----------
        commands : sequence of DriveCommand or None
            As `exchange`; None = the last ones.
        """
        self._stage(commands)
        with self._stopping():
            self._parts()[0].begin(self._enable_words)

    def prepare(self, at_s: float | None = None) -> float:
        """Second part: wait until the SYNC is due, by this group's clock or as it is due by that of another one.

        Parameters
        ----------
        at_s : float, optional
            What `prepare` of the other group has returned.

        Returns
        -------
        float
            Monotonic time, s.

        Raises
        ------
        MasterStalled
            As `exchange`.
        """
        exchange, _ = self._parts()
        with self._stopping():
            if at_s is None:
                at_s = exchange.clock.wait()
            else:
                exchange.clock.follow(at_s)
            exchange.prepare(at_s)
        return at_s

    def sync(self) -> None:
        """Third part: the SYNC; raises `BusError`, and all axes have been stopped."""
        with self._stopping():
            self._parts()[0].sync()

    def gather(self) -> Epoch:
        """Fourth part: what was answered, not looked at yet; raises `BusError`, and all axes have been stopped."""
        with self._stopping():
            return self._parts()[0].gather()

    def check(self, epoch: Epoch) -> None:
        """Fifth part: see that all is well; raises as `exchange`."""
        with self._stopping():
            self._looked_at(epoch)

    def abandon(self) -> None:
        """Leave a SYNC that was begun; the axes stay where the last one has told them."""
        if self._exchange is not None:
            self._exchange.abandon()

    def fall_silent(self, commands: Sequence[Sequence[DriveCommand]]) -> tuple[StopTrace, ...]:
        """Stop the master's heartbeat on purpose while the axes move, watch each drive stop by itself, disable all.

        Parameters
        ----------
        commands : sequence of sequences of DriveCommand
            Set points that go on without a heartbeat, one row per SYNC; slow ones.

        Returns
        -------
        tuple of StopTrace
            One per axis. A drive that reacts with a fault stays in it.

        Raises
        ------
        SeveralFailures or DriveError
            A frame could not be sent, or axes of which it is not known that they are disabled.
        """
        self._require(self.enabled, "enable() first")
        exchange, _ = self._parts()
        self.enabled = False
        try:
            traces = fall_silent(exchange, commands, self._last_beat)
        except BaseException as error:
            self._after(error, stopping.quick_stop)
            raise
        try:
            if any(trace.left_s is None for trace in traces):
                self.quick_stop()
        finally:
            self.disable()
        return traces

    def prove_quick_stop(self, commands: Sequence[Sequence[DriveCommand]]) -> tuple[StopTrace, ...]:
        """Move, then tell every axis to stop by its quick stop ramp, watch each come to rest, disable all.

        Parameters
        ----------
        commands : sequence of sequences of DriveCommand
            Set points before the stop, one row per SYNC; slow ones.

        Returns
        -------
        tuple of StopTrace
            One per axis; times and angles count from the SYNC that carried the quick stop.

        Raises
        ------
        SeveralFailures or DriveError
            As `exchange`; or axes of which it is not known that they are disabled.
        """
        for row in commands:
            self.exchange(row)
        self._require(self.enabled, "enable() first")
        exchange, _ = self._parts()
        self.enabled = False
        try:
            traces = watch_quick_stop(exchange)
        except BaseException as error:
            self._after(error, stopping.quick_stop)
            raise
        try:
            if not all(trace.stood for trace in traces):
                self.quick_stop()
        finally:
            self.disable()
        return traces

    def release(self, axis: int, seconds: float) -> float:
        """Disable one axis, so that its brake holds it, while all others hold; watch it; then disable all.

        Parameters
        ----------
        axis : int
            From 0.
        seconds : float
            How long it is watched once it has left OPERATION ENABLED.

        Returns
        -------
        float
            Largest motor angle from where the drive last held it, rad.

        Raises
        ------
        ConfigurationRefused
            The axes are not enabled, or do not come to rest; nothing has changed.
        TransitionTimeout
            The axis stays in OPERATION ENABLED. All axes are disabled.
        DriveError
            As `exchange`. All axes are disabled, as far as that was possible.
        """
        self._require(self.enabled and 0 <= axis < len(self.drives), "enable() first, and name an axis that there is")
        exchange, guard = self._parts()
        self._come_to_rest(exchange)
        guard.excused = frozenset({axis})
        try:
            sag_rad = watch_released(exchange, axis, seconds, self._cycle)
        except BaseException as error:
            if self.enabled:
                self._after(error, stopping.quick_stop)
            self._disable_after(error)
            raise
        self.disable()
        return sag_rad

    def _come_to_rest(self, exchange: SyncExchange) -> None:
        """Hold until every axis was seen to stand."""
        axes = range(len(self.drives))
        for _ in range(math.ceil(_REST_S / self.timing.period_s)):
            self.hold()
            if all(exchange.stands(axis) for axis in axes):
                return
        self._require(False, "bring the axes to rest first")

    def _last_beat(self) -> None:
        """One more heartbeat, from which the drives count, and no other."""
        self._producer.start(self.sync_index * self.timing.period_s)
        self._producer.stop()

    def _cycle(self, words: Sequence[int] | None = None) -> Epoch:
        with self._stopping():
            return self._looked_at(self._parts()[0].cycle(self._enable_words if words is None else words))

    def _looked_at(self, epoch: Epoch) -> Epoch:
        self._emcy.sync_index = epoch.sync_index
        self._parts()[1].check(epoch)
        return epoch

    @contextmanager
    def _stopping(self) -> Generator[None]:
        """What fails stops all axes before it is raised."""
        exchange, guard = self._parts()
        try:
            yield
        except Exception as error:
            exchange.abandon()
            self.enabled = False
            self._after(error, stopping.quick_stop)
            if isinstance(error, DriveError):
                guard.explain(error)
            raise

    def _after(self, error: BaseException, stop: Callable[[SyncExchange], list[DriveError]]) -> None:
        """Stop what runs because of an error, which is about to be raised; what goes wrong is added to it."""
        self.enabled = False
        if any(isinstance(each, DriveRebooted) for each in getattr(error, "failures", (error,))):
            self._configured = False
        failures: list[DriveError] = []
        try:
            self.on_stop()
        except Exception as failed:
            failures.append(while_stopping(failed))
        if self._running and self._exchange is not None:
            failures += self._stopped(stop)
            if stop is stopping.disable:
                failures += self._stand_down(failures)
        for failure in failures:
            _add(error, failure)

    def _disable_after(self, error: BaseException) -> None:
        """Disable because of an error, which is about to be raised; what goes wrong is added to it."""
        try:
            self.disable()
        except DriveError as failure:
            _add(error, failure)

    def _stopped(self, stop: Callable[[SyncExchange], list[DriveError]]) -> list[DriveError]:
        """What could not be confirmed: then no heartbeat is sent any more, and the drives are set up anew first."""
        exchange, _ = self._parts()
        try:
            failures = stop(exchange)
        except Exception as error:
            failures = [while_stopping(error)]
        self.sag_rad = exchange.sag_rad
        if failures:
            self._producer.stop()
            self._configured = False
        return failures

    # -- stopping ----------------------------------------------------------------------------------------------------

    def quick_stop(self) -> None:
        """Stop every axis by its quick stop ramp and wait until it stands; they stay under power as the drives decide.

        Raises
        ------
        SeveralFailures or DriveError
            Axes of which it is not known that they stand.
        """
        self.enabled = False
        if self._running and self._exchange is not None:
            raise_failures(self._stopped(stopping.quick_stop))

    def disable(self) -> None:
        """Disable every axis and let the drives stop watching the master; does nothing when nothing runs.

        Axes that move are brought to rest by their quick stop ramps first. Afterwards positions are watched for 0.3 s:
        `sag_rad`.

        Raises
        ------
        SeveralFailures or DriveError
            Axes of which it is not known that they are disabled, or that did not come to rest before.
        """
        self.enabled = False
        if self._running and self._exchange is not None:
            failures = self._stopped(stopping.disable)
            failures += self._stand_down(failures)
            raise_failures(failures)

    def _stand_down(self, unreached: list[DriveError]) -> list[DriveError]:
        """Disarm the heartbeat consumers of the drives that answer, then stop the heartbeat."""
        silent = {error.node for error in unreached if isinstance(error, SdoTimeout)}
        failures: list[DriveError] = []
        for drive in self.drives:
            try:
                if drive.node_id not in silent:
                    drive.disarm()
                    drive.note_rest()
            except Exception as error:
                failures.append(while_stopping(error, drive.node_id))
        self._producer.stop()
        self._running = False
        self._bus.free_count = self._bus.foreign_count
        return failures

    def close(self) -> None:
        """Disable if enabled, leave the drives in PRE-OPERATIONAL, stop listening; may be called again."""
        try:
            self.disable()
        finally:
            self._producer.stop()
            try:
                for node in (*self.drives, *self.instruments) if self._exchange is not None else ():
                    send_nmt(self._bus, NmtCommand.ENTER_PREOPERATIONAL, node.node_id)
            except Exception:
                self._bus.counts["unsent_at_close"] += 1
            self._forget()
            self._bus.remove_chore(self._beat)

    def __enter__(self) -> DriveGroup:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except DriveError as failure:
            if error is None:
                raise
            _add(error, failure)


def _add(error: BaseException, failure: DriveError) -> None:
    """What went wrong while stopping because of an error becomes part of it."""
    if isinstance(error, DriveError):
        error.while_stopping += (failure,)
    else:
        error.add_note(f"while stopping: {failure}")
