"""The drives of one arm under one SYNC: found, configured, enabled, moved, stopped, put back.

Nothing is automatic: no fault is reset, no axis is enabled, homed or stored without being told to. When an axis leaves
OPERATION ENABLED by itself, stops answering, boots or falls silent, every axis is stopped before the error is raised.

While axes are enabled, `exchange` or `hold` has to be called again before the drives' heartbeat time is over: the
heartbeat of the master is sent from there, so that a master that hangs stops the arm as a dead one does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from drives import bringup, operational, starting, stopping
from drives.cia402 import Mode
from drives.drive import DriveCommand
from drives.epoch import Epoch
from drives.errors import BusError, ConfigurationRefused, DriveError, DriveRebooted, SdoTimeout, raise_failures
from drives.exchange import SyncExchange
from drives.group_setup import DriveSetup, GroupOptions
from drives.guard import Guard
from drives.heartbeat import NmtCommand, send_nmt
from drives.proof import StopTrace, fall_silent
from drives.way_up import WayUp

__all__ = ["DriveGroup", "GroupOptions"]


class DriveGroup(DriveSetup):
    """Drives that follow one SYNC; parameters as `DriveSetup`."""

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
        exchange.restart()
        self._producer.start(exchange.sync_time_s)
        self._running = True
        epoch = self._start_nodes(exchange, guard, way)
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
        """
        if not self.enabled:
            self._require(False, "enable() first")
        for drive, command in zip(self.drives, commands, strict=True):
            drive.stage(command)
        return self._cycle()

    def hold(self) -> Epoch:
        """One SYNC with the last commanded positions and no torque offset; raises as `exchange`."""
        self._require(self.enabled, "enable() first")
        for drive in self.drives:
            drive.hold(drive.target_count)
        return self._cycle()

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

    def _last_beat(self) -> None:
        """One more heartbeat, from which the drives count, and no other."""
        self._producer.start(self.sync_index * self.timing.period_s)
        self._producer.stop()

    def _cycle(self) -> Epoch:
        exchange, guard = self._parts()
        try:
            epoch = self.last_epoch = exchange.cycle(self._enable_words)
            self._emcy.sync_index = epoch.sync_index
            guard.check(epoch)
        except DriveError as error:
            self.enabled = False
            self._after(error, stopping.quick_stop)
            guard.explain(error)
            raise
        return epoch

    def _after(self, error: BaseException, stop: Callable[[SyncExchange], list[DriveError]]) -> None:
        """Stop what runs because of an error, which is about to be raised; what goes wrong is added to it."""
        self.enabled = False
        if isinstance(error, DriveRebooted):
            self._configured = False
        failures: list[DriveError] = []
        self.on_stop()
        if self._running and self._exchange is not None:
            failures = stop(self._exchange)
            if stop is stopping.disable:
                failures += self._stand_down(failures)
        if isinstance(error, DriveError):
            error.while_stopping = tuple(failures)

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
            raise_failures(stopping.quick_stop(self._exchange))

    def disable(self) -> None:
        """Disable every axis and let the drives stop watching the master; does nothing when nothing runs.

        Raises
        ------
        SeveralFailures or DriveError
            Axes of which it is not known that they are disabled.
        """
        self.enabled = False
        if self._running and self._exchange is not None:
            failures = stopping.disable(self._exchange)
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
            except DriveError as error:
                failures.append(error)
        self._producer.stop()
        self._running = False
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
            except BusError:
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
            if isinstance(error, DriveError):
                error.while_stopping += (failure,)
