"""Group of the drives of one arm that share one SYNC: enable, move, stop, test and disable them.

Nothing is automatic: faults are reset and axes enabled only on request. When an axis leaves OPERATION ENABLED without a
command, boots, or stops responding, every axis is stopped before the error is raised.

While axes are enabled, `exchange` or `hold` has to be called again before the drives' heartbeat time has passed. They
send the master's heartbeat, so that a blocked master stops the arm as a crashed one does.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from typing import Final, TypeVar, TypeVarTuple

from drives import bringup, enabling, stopping
from drives.cia402 import ENABLE_OPERATION
from drives.drive import DriveCommand
from drives.epoch import Epoch
from drives.errors import (
    ConfigurationRefused,
    DriveError,
    NotStoodDown,
    SdoTimeout,
    StopRequested,
    TransitionTimeout,
    raise_failures,
    while_stopping,
)
from drives.exchange import GroupOptions, SyncExchange
from drives.gate import ArmState, DriveState, Gate
from drives.heartbeat import HeartbeatWatch, NmtCommand, NmtState, send_nmt
from drives.monitor import Monitor
from drives.nodes import Nodes
from drives.proof import BrakeTest, DriveTest, HeartbeatLossTest, QuickStopTest
from drives.reactions import DRIVE_RULES
from drives.statistics import GroupStatistics, group_statistics
from drives.values import Identity

__all__ = ["DriveGroup", "GroupOptions"]

Values = TypeVarTuple("Values")
Returned = TypeVar("Returned")

#: While a person is at the arm: interval at which every drive is read [s].
_GATE_EVERY_S: Final = 1.0
#: And how long one call listens [s]; a quarter of the shortest heartbeat time is longer.
_ATTEND_S: Final = 0.02


class DriveGroup(Nodes):
    """Drives of one arm that share one SYNC.

    Before `exchange`, `hold` or a stop test raises an error, all axes are stopped by their quick stop ramps as far as
    possible. The drives decide whether power stays on; call `disable` or `close` afterwards. Where a
    stop is not confirmed, the master's heartbeat has ended, and the drives have to be found and configured again before
    they can be enabled.

    Parameters as `Nodes`, which raises their errors.
    """

    #: Every axis is in OPERATION ENABLED and follows `exchange`.
    enabled = False
    #: Called before the axes are stopped because of an error, so that other arms stop in the same cycle.
    on_stop: Callable[[], None] | None = None
    _watch: HeartbeatWatch | None = None
    _exchange: SyncExchange | None = None
    _monitor: Monitor | None = None
    _gate: Gate | None = None
    _running = False
    #: Stop test in progress; None = none.
    _test: DriveTest | None = None
    #: Monotonic time of the last gate [s].
    _gated_s = 0.0

    @property
    def sync_index(self) -> int:
        """Return the number of the last SYNC."""
        return 0 if self._exchange is None else self._exchange.sync_index

    @property
    def sync_sent_s(self) -> float:
        """Return the monotonic time of the last SYNC [s]."""
        return 0.0 if self._exchange is None else self._exchange.sent_s

    @property
    def statistics(self) -> GroupStatistics:
        """Return the counters and latencies so far."""
        return group_statistics(self, self._exchange)

    def _require(self, condition: bool, advice: str) -> None:
        if not condition:
            raise ConfigurationRefused("the drives are not ready for this", advice=advice)

    def _parts(self) -> tuple[SyncExchange, Monitor]:
        if self._exchange is None or self._monitor is None:
            raise ConfigurationRefused("the drives are not configured", advice="connect() and configure() first")
        return self._exchange, self._monitor

    # -- bringing up -------------------------------------------------------------------------------------------------

    def connect(self) -> tuple[Identity, ...]:
        """Find every node and compare it with its profile; raises as `bringup.connect`."""
        self._close_exchange()
        bringup.connect(self)
        return tuple(drive.identity for drive in self.drives)

    def configure(self) -> None:
        """Configure every node, and prepare the exchange; raises as `bringup.configure`."""
        self._require(bool(self.drives) and not self._running, "connect() first, and do not configure while enabled")
        first_index = self.sync_index
        self._close_exchange()
        exchange = SyncExchange(self.bus, self.drives, self.timing, self.heartbeat, first_index, self.instruments)
        try:
            bringup.configure(self)
        except BaseException:
            exchange.close()
            raise
        # the allowed gap in a heartbeat is three of its periods, and not below the rule's limit
        periods_ms = {drive.node_id: drive.setup.profile.heartbeat.producer_ms for drive in self.drives}
        least_s = DRIVE_RULES["heartbeat_lost"].limit
        gaps_s = [None if each is None else max(least_s, 3.0 * each / 1000.0) for each in periods_ms.values()]
        watch = HeartbeatWatch(self.bus, tuple(periods_ms), gaps_s, lambda: exchange.sync_time_s)
        self._exchange, self._watch = exchange, watch
        self._monitor = Monitor(self.bus, exchange, watch, self.emcy, {"silent": self.options.unanswered_syncs})
        self._gate = Gate(self.bus, self.drives, watch, self.emcy)

    def _close_exchange(self) -> None:
        for listener in (self._watch, self._exchange):
            if listener is not None:
                listener.close()
        self._watch = self._exchange = self._monitor = self._gate = None

    def restore(self) -> None:
        """Restore every object that is in the ledger, after which the drives have to be configured again.

        Raises
        ------
        ConfigurationRefused
            The drives are enabled.
        SeveralFailures or DriveError
            As `Nodes.restore`.
        """
        self._require(not self._running, "disable() before restoring")
        self._close_exchange()
        super().restore()

    # -- looking before anything is done ------------------------------------------------------------------------------

    def gate(self, *, full: bool = False) -> ArmState:
        """Read every drive: what may be done with the arm, and what may be said of it; nothing is written.

        Drives that were exchanged, restarted, moved or written by others have to be configured again.

        Parameters
        ----------
        full : bool
            Also identity, configuration and the conditions for power, as before power comes on.
        """
        if self._gate is None:
            raise ConfigurationRefused("the drives are not configured", advice="connect() and configure() first")
        state = self._gate.read(full=full)
        self._gated_s = time.monotonic()
        return state

    def positions_rad(self) -> list[float]:
        """Read the motor positions by SDO."""
        return [drive.access.read(drive.setup.profile.position.object) * drive.scale.count_rad for drive in self.drives]

    @property
    def brake_drop_rad(self) -> tuple[float, ...]:
        """Return the motor angle of each axis from where it was last held to the farthest place after it was disabled.

        0.0 = unknown.
        """
        return (0.0,) * len(self.drives) if self._exchange is None else self._exchange.brake_drop_rad

    def attend(self) -> None:
        """Keep the bus for a moment while a person is at the arm, which is in its brakes; call it again and again.

        The master's heartbeat goes on for other masters on the bus, and every drive is read once a second.

        Raises
        ------
        DriveError, SeveralFailures
            What has changed since the gate before: the arm is not safe to approach.
        """
        self._require(not self._running, "disable() first")
        if not self.heartbeat.running:
            self.heartbeat.start()
        self.bus.listen(_ATTEND_S)
        if time.monotonic() - self._gated_s >= _GATE_EVERY_S:
            self.gate().require_approach()

    # -- moving ------------------------------------------------------------------------------------------------------

    def enable(self, stop_requested: Callable[[], bool] = lambda: False) -> Epoch:
        """Bring every axis to OPERATION ENABLED, where it holds the position it is at.

        Parameters
        ----------
        stop_requested : callable
            Called at every SYNC until the brakes are open: whether a person has requested a stop.

        Returns
        -------
        Epoch
            The last one; complete, every axis enabled.

        Raises
        ------
        IdentityMismatch, DriveRebooted, ConfigurationRefused
            A drive was exchanged, restarted or written since it was configured; no axis was enabled.
        DriveFault, NotOperational, TransitionTimeout, IncompleteEpochs, SeveralFailures
            All axes are disabled again. A drive in FAULT is refused and never reset; one that falls back while being
            enabled is not enabled again.
        StopRequested
            All axes are disabled again.
        """
        exchange, monitor = self._parts()
        self._require(not self.enabled, "enable() once")
        self.gate(full=True).require_power()
        if stop_requested():
            raise StopRequested("a stop was requested before the drives were enabled")
        try:
            raise_failures(self.failures(lambda drive: drive.arm(), self.drives))
            self.ledger.settle()
            self.gate().require_approach()  # what happened while the consumer times were written
            monitor.forgive()
            self.bus.free_count = None  # from now on the monitor watches for other masters
            exchange.restart()
            self.heartbeat.start()
            self._running = True
            epoch = enabling.enable(self.bus, exchange, self.instruments, monitor, stop_requested)
        except BaseException as error:
            self._after(error, stopping.disable)
            if isinstance(error, DriveError):
                monitor.explain(error)
            raise
        self.enabled = True
        return epoch

    def exchange(self, commands: Sequence[DriveCommand]) -> Epoch:
        """Run one SYNC cycle: send a target to every axis and collect the readings of every axis.

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
            A target outside the limits; nothing was sent, and the axes hold their last targets.
        DriveFault, DriveRebooted, HeartbeatLost, IncompleteEpochs, ForeignMaster, BusError, SeveralFailures
            All axes have been stopped.
        MasterStalled
            In real time: this computer stalled while the axes moved. These targets were not sent; all axes have been
            stopped. At rest, the row of a delayed SYNC is only marked incomplete.
        """
        self._stage(commands)
        return self._stopping(self._cycle)

    def hold(self) -> Epoch:
        """Run one SYNC cycle with the last commanded positions and no torque offset; raises as `exchange`."""
        self._stage(None)
        return self._stopping(self._cycle)

    def _stage(self, commands: Sequence[DriveCommand] | None) -> None:
        if not self.enabled:
            self._require(False, "enable() first")
        test, targets = self._test, (None,) * len(self.drives) if commands is None else commands
        for axis, (drive, command) in enumerate(zip(self.drives, targets, strict=True)):
            count = None if test is None else test.held_count(axis)
            if count is None and command is not None:
                drive.stage(command)
            else:
                drive.hold(drive.target_count if count is None else count)

    def align(self, at_s: float) -> None:
        """Real time: set when the next SYNC is due (monotonic), so that several groups share one phase."""
        exchange, _ = self._parts()
        exchange.clock.restart(at_s)

    def begin(self, commands: Sequence[DriveCommand] | None) -> None:
        """Real time, first part of a SYNC shared by several groups: send targets; raises as `exchange`.

        Then, in the same thread and for all groups before the next part: `prepare`, `sync`, `gather` and `check`. If
        anything fails, call `abandon` on the groups that have begun.

        Parameters
        ----------
        commands : sequence of DriveCommand or None
            As `exchange`; None = the last ones.
        """
        self._stage(commands)
        self._stopping(self._parts()[0].begin, (ENABLE_OPERATION,) * len(self.drives))

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
        return self._stopping(self._parts()[0].prepare, at_s)

    def sync(self) -> None:
        """Third part: the SYNC; raises `BusError`, and all axes have been stopped."""
        self._stopping(self._parts()[0].sync)

    def gather(self) -> Epoch:
        """Fourth part: collect the responses unchecked; raises `BusError` after all axes have been stopped."""
        return self._stopping(self._parts()[0].gather)

    def check(self, epoch: Epoch) -> None:
        """Fifth part: check the epoch; raises as `exchange`."""
        self._stopping(self._looked_at, epoch)

    def abandon(self) -> None:
        """Abandon a SYNC that was begun; the axes keep their last targets."""
        if self._exchange is not None:
            self._exchange.abandon()

    def withhold_heartbeat(self) -> HeartbeatLossTest:
        """Withhold the master's heartbeat while the axes move: every drive has to stop itself.

        `exchange` and `hold` go on, with the controlwords of the test, until `disable`.

        Returns
        -------
        HeartbeatLossTest
            A drive that reacts with a fault stays in it.
        """
        self._require(self.enabled, "enable() first")
        self._test = test = HeartbeatLossTest(self._parts()[0])
        return test

    def try_quick_stop(self) -> QuickStopTest:
        """Command a quick stop of every axis; `exchange` and `hold` go on until `disable`.

        Returns
        -------
        QuickStopTest
            Its times and angles count from the SYNC that carries the quick stop.
        """
        self._require(self.enabled, "enable() first")
        self._test = test = QuickStopTest(self._parts()[0])
        return test

    def release(self, axis: int, limit_rad: float, disables_voltage: bool = False) -> BrakeTest:
        """Disable one axis, so that its brake holds it, while all others hold; `hold` goes on.

        Parameters
        ----------
        axis, limit_rad, disables_voltage
            As `BrakeTest`.

        Raises
        ------
        ConfigurationRefused
            The axes are not enabled, or not at rest; nothing has changed.
        """
        self._require(self.enabled and 0 <= axis < len(self.drives), "enable() first, and name an axis that there is")
        self._require(self.is_at_rest, "bring the axes to rest first")
        self._test = test = BrakeTest(self._parts()[0], axis, limit_rad, disables_voltage)
        return test

    @property
    def is_at_rest(self) -> bool:
        """Return whether every axis was at rest at the last SYNCs."""
        exchange, _ = self._parts()
        return all(exchange.is_at_rest(axis) for axis in range(len(self.drives)))

    def _cycle(self) -> Epoch:
        words = (ENABLE_OPERATION,) * len(self.drives) if self._test is None else self._test.controlwords()
        return self._looked_at(self._parts()[0].cycle(words))

    def _looked_at(self, epoch: Epoch) -> Epoch:
        self.emcy.sync_index = epoch.sync_index
        monitor, test = self._parts()[1], self._test
        if test is not None:
            test.see(epoch)
            monitor.excuse(test.excused)
            if not test.guards:
                monitor.check_rules("bus")
                return epoch
        monitor.check(epoch)
        return epoch

    def _stopping(self, part: Callable[[*Values], Returned], *values: *Values) -> Returned:
        """Run a part of a cycle; any error stops all axes before it is raised."""
        exchange, monitor = self._parts()
        try:
            return part(*values)
        except Exception as error:
            exchange.abandon()
            self.enabled = False
            self._after(error, stopping.quick_stop)
            if isinstance(error, DriveError):
                monitor.explain(error)
            raise

    def _after(self, error: BaseException, stop: Callable[[SyncExchange], list[DriveError]]) -> None:
        """Stop all axes because of an error that is about to be raised; failures while stopping are added to it."""
        self.enabled = False
        failures: list[DriveError] = []
        try:
            if self.on_stop is not None:
                self.on_stop()
        except Exception as failed:
            failures.append(while_stopping(failed))
        if self._running and self._exchange is not None:
            unconfirmed = self._stopped(stop)
            failures += unconfirmed
            if stop is stopping.disable:
                later = self._stand_down(unconfirmed)
                if later and not unconfirmed:
                    error.add_note(f"after the stop: {_not_stood_down(later)}")
                else:
                    failures += later
        for failure in failures:
            _add(error, failure)

    def _stopped(self, stop: Callable[[SyncExchange], list[DriveError]]) -> list[DriveError]:
        """Handle unconfirmed commands: the heartbeat stays off, and the drives have to be configured again."""
        exchange, _ = self._parts()
        self._test = None
        try:
            failures = stop(exchange)
        except Exception as error:
            failures = [while_stopping(error)]
        if failures:
            self.heartbeat.stop()
            if self._gate is not None:
                self._gate.mistrust(failures)
        return failures

    # -- stopping ----------------------------------------------------------------------------------------------------

    def quick_stop(self) -> None:
        """Stop every axis by its quick stop ramp and wait until it is at rest; whether power stays on depends on the
        drive.

        Raises
        ------
        SeveralFailures or DriveError
            Axes that are not confirmed to be at rest.
        """
        self.enabled = False
        if self._running and self._exchange is not None:
            raise_failures(self._stopped(stopping.quick_stop))

    def disable(self) -> None:
        """Disable every axis and let the drives stop watching the master; does nothing when nothing runs.

        Axes that move are brought to rest by their quick stop ramps first. Afterwards positions are watched for 0.3 s:
        `brake_drop_rad`.

        Raises
        ------
        SeveralFailures or DriveError
            Axes of which it is not known that they are disabled, or that did not come to rest before.
        """
        self.enabled = False
        if self._running and self._exchange is not None:
            failures = self._stopped(stopping.disable)
            later = self._stand_down(failures)
            if later and not failures:
                raise _not_stood_down(later)
            raise_failures(failures + later)

    def _stand_down(self, unreached: list[DriveError]) -> list[DriveError]:
        """Disarm the heartbeat consumers of the disabled drives, stop the heartbeat, leave OPERATIONAL.

        A drive that was not confirmed to be disabled goes on watching for the heartbeat, so that it stops by itself. A
        failure here says nothing about the axes: whether they are disabled was read before.
        """
        not_disabled = {error.node for error in unreached if isinstance(error, SdoTimeout | TransitionTimeout)}
        failures: list[DriveError] = []
        for drive in self.drives:
            try:
                if drive.node_id not in not_disabled:
                    drive.disarm()
                    drive.rest_count = drive.access.read(drive.setup.profile.position.object)
            except DriveError as error:
                failures.append(error)
            except Exception as error:
                what = f"{type(error).__name__}: {error}"
                failures.append(DriveError(what, node=drive.node_id, advice="report this"))
        self.heartbeat.stop()
        self._running = False
        if self._gate is not None:
            self._gate.restart()
        self.bus.free_count = self.bus.foreign_count
        try:
            if not failures and not unreached:
                self._to_preoperational()  # no PDO of any master can enable them now
            self.ledger.settle()
        except DriveError as error:
            failures.append(error)
        return failures

    def _to_preoperational(self) -> None:
        if self._watch is not None:
            self._watch.command(NmtState.PREOPERATIONAL)
        for node in self.all:
            send_nmt(self.bus, NmtCommand.ENTER_PREOPERATIONAL, node.node_id)

    def close(self) -> None:
        """Disable if enabled, leave the drives in PRE-OPERATIONAL, stop listening; may be called again.

        Raises
        ------
        SeveralFailures or DriveError
            As `disable`; the state in which each drive was read last is in the notes.
        """
        try:
            self.disable()
        except DriveError as error:
            seen = zip(self.drives, self._parts()[0].states, strict=True)
            read_at = datetime.now(UTC) - timedelta(seconds=time.monotonic() - self.sync_sent_s)
            error.add_note(f"{ArmState(tuple(DriveState(drive.node_id, state) for drive, state in seen), read_at)}.")
            raise
        finally:
            self.heartbeat.stop()
            try:
                if self._exchange is not None:
                    self._to_preoperational()
            except Exception:
                self.bus.counts["unsent_at_close"] += 1
            self._close_exchange()
            super().close()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except DriveError as failure:
            if error is None:
                raise
            _add(error, failure)


def _not_stood_down(failures: list[DriveError]) -> NotStoodDown:
    """Return the error for drives that were read as disabled and whose heartbeat watch could not be ended."""
    what = "; ".join(str(failure) for failure in failures)
    advice = "a drive that still monitors the master may report its loss: `servo-gateway restore CELL` ends that"
    return NotStoodDown(f"every drive was read as disabled; then: {what}", advice=advice)


def _add(error: BaseException, failure: DriveError) -> None:
    """Append the failures of a stop to the error that caused the stop."""
    if isinstance(error, DriveError):
        error.while_stopping += (failure,)
    else:
        error.add_note(f"while stopping: {failure}")
