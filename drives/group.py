"""The drives of one arm under one SYNC: found, configured, enabled, moved, stopped, put back.

Nothing is automatic: no fault is reset, no axis is enabled, homed or stored without being told to. When an axis leaves
OPERATION ENABLED by itself, stops answering, boots or falls silent, every axis is stopped before the error is raised.

While axes are enabled, `exchange` or `hold` has to be called again before the drives' heartbeat time is over: the
heartbeat of the master is sent from there, so that a master that hangs stops the arm as a dead one does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drives import bringup, finding, starting, stopping
from drives.access import ObjectAccess
from drives.bus import EMCY_BASE, Bus
from drives.busload import load_percent
from drives.cia402 import ENABLE_OPERATION, Mode
from drives.drive import AxisSetup, Cia402Drive, DriveCommand, Identity
from drives.emcy import EmcyLog
from drives.epoch import Epoch
from drives.errors import (
    BusError,
    BusOverload,
    ConfigurationRefused,
    DriveError,
    DriveRebooted,
    NodeMissing,
    SdoTimeout,
    raise_failures,
)
from drives.exchange import Pacing, SyncExchange, Timing
from drives.guard import Guard, Limits, refuse_foreign
from drives.heartbeat import HeartbeatProducer, HeartbeatWatch, NmtCommand, send_nmt
from drives.ledger import WriteLedger
from drives.proof import StopTrace, fall_silent
from drives.reactions import DRIVE_RULES
from drives.statistics import GroupStatistics, group_statistics

#: Before anything is sent: how long to listen for another master.
_LISTEN_S: Final = 0.05
_SHORTEST_SILENCE_S: Final = DRIVE_RULES["heartbeat_lost"].limit


@dataclass(frozen=True, slots=True)
class GroupOptions:
    """Times and limits of a group; the defaults suit six drives.

    Attributes
    ----------
    ledger_path : Path, optional
        Where the write ledger is kept, so that a restore is possible after a crash.
    answer_timeout_s, gap_timeout_s, window : float
        As in `drives.exchange.Timing`.
    silent_syncs : int or None
        As in `drives.guard.Limits`; None = as the table of reactions says.
    foreign_frames : int
        As in `drives.guard.Limits`.
    load_limit_percent : float
        By the clock: largest planned worst-case bus load.
    """

    ledger_path: Path | None = None
    answer_timeout_s: float = 1.0
    gap_timeout_s: float = 0.02
    window: float = 0.9
    silent_syncs: int | None = None
    foreign_frames: int = DRIVE_RULES["foreign_master"].count
    load_limit_percent: float = 70.0


class DriveGroup:
    """Drives that follow one SYNC.

    Parameters
    ----------
    bus : Bus
    setups : sequence of AxisSetup
        One per axis, in the order of all commands and readings.
    sync_period_s : float
        Time between two SYNCs; in lockstep the time that a SYNC stands for.
    pacing : "lockstep" or "real"
        Next SYNC as soon as all have answered, or by the clock.
    master_node_id : int
        Node id of the master's heartbeat.
    options : GroupOptions, optional

    Raises
    ------
    ConfigurationRefused
        No setup, a node id twice, a period that is not positive, or a damaged ledger.
    """

    def __init__(
        self,
        bus: Bus,
        setups: Sequence[AxisSetup],
        sync_period_s: float,
        pacing: Pacing = "lockstep",
        master_node_id: int = 127,
        options: GroupOptions | None = None,
    ) -> None:
        ids = [setup.node_id for setup in setups]
        if not ids or len({*ids, master_node_id}) != len(ids) + 1:
            raise ConfigurationRefused(
                f"node ids {ids} and {master_node_id} of the master must each be given once", advice="correct the cell"
            )
        if not (math.isfinite(sync_period_s) and sync_period_s > 0):
            raise ConfigurationRefused(f"SYNC period {sync_period_s} s is not positive", advice="correct the cell")
        self.setups = tuple(setups)
        self.options = options or GroupOptions()
        self.timing = Timing(
            sync_period_s, pacing, self.options.answer_timeout_s, self.options.gap_timeout_s, self.options.window
        )
        self.ledger = WriteLedger(self.options.ledger_path)
        self.drives: tuple[Cia402Drive, ...] = ()
        #: Every axis is in OPERATION ENABLED and follows `exchange`.
        self.enabled = False
        #: The last row, also the one that led to an error.
        self.last_epoch: Epoch | None = None
        #: Called before the axes are stopped because of an error: what moves with them is told in the same cycle.
        self.on_stop: Callable[[], None] = lambda: None
        self._bus = bus
        self._master_node_id = master_node_id
        consumer_s = min(setup.profile.heartbeat.consumer_ms for setup in setups) / 1000.0
        self._producer = HeartbeatProducer(bus, master_node_id, consumer_s)
        self._emcy = EmcyLog({setup.node_id: setup.profile for setup in setups})
        self._watch: HeartbeatWatch | None = None
        self._exchange: SyncExchange | None = None
        self._guard: Guard | None = None
        self._running = self._configured = False
        self._enable_words = (ENABLE_OPERATION,) * len(ids)
        bus.add_chore(self._beat)

    def _beat(self) -> None:
        self._producer.tick(0.0 if self._exchange is None else self._exchange.sync_time_s)

    # -- finding and setting up --------------------------------------------------------------------------------------

    def connect(self) -> tuple[Identity, ...]:
        """Find every drive and compare it with its profile; no object is written.

        Raises
        ------
        NodeMissing, DuplicateNode, IdentityMismatch, SeveralFailures
            Everything that is wrong, of all drives at once.
        ForeignMaster
            Somebody else sends SYNC or NMT commands.
        """
        self._forget()
        refuse_foreign(self._bus, max(_LISTEN_S, 3.0 * self.timing.period_s))
        answers = finding.count_answers(self._bus, self.setups)
        self.drives = tuple(Cia402Drive(self._bus, setup, self.ledger) for setup in self.setups)
        for drive in self.drives:
            self._bus.subscribe(EMCY_BASE + drive.node_id, self._emcy.on_frame)
        identities: list[Identity] = []
        try:
            self._for_each(lambda drive: identities.append(finding.identify(drive, answers[drive.node_id])))
        except DriveError:
            self._forget()
            raise
        return tuple(identities)

    def configure(self) -> None:
        """Map the PDOs, set mode, period, heartbeats and the reaction to a lost master; everything is read back.

        Raises
        ------
        BusOverload
            By the clock: the exchange would fill more of the wire than allowed.
        SeveralFailures or DriveError
            What failed, of all drives at once.
        """
        self._require(bool(self.drives) and not self._running, "connect() first, and do not configure while enabled")
        first_index = 0 if self._exchange is None else self._exchange.sync_index
        self._close_exchange()
        exchange = SyncExchange(self._bus, self.drives, self.timing, self._producer, first_index)
        try:
            self._check_load(exchange)
            self._for_each(lambda drive: drive.configure(self.timing.period_s))
            self._for_each(lambda drive: drive.arm(self._master_node_id))
        except BaseException:
            exchange.close()
            raise
        limits = [_silence_s(drive.setup) for drive in self.drives]
        node_ids = [drive.node_id for drive in self.drives]
        watch = HeartbeatWatch(self._bus, node_ids, limits, lambda: exchange.sync_time_s)
        self._exchange, self._watch = exchange, watch
        silent = self.options.silent_syncs or DRIVE_RULES["silent"].syncs(self.timing.period_s, self.timing.pacing)
        guard_limits = Limits(silent, self.options.foreign_frames)
        self._guard = Guard(self._bus, exchange, watch, self._emcy, guard_limits)
        self._configured = True

    def _check_load(self, exchange: SyncExchange) -> None:
        spec, allowed = self._bus.spec, self.options.load_limit_percent
        load = load_percent(exchange.cycle_bits, self.timing.period_s, spec.bitrate_bit_s)
        if self.timing.pacing == "real" and load > allowed:
            period_s = exchange.cycle_bits / (spec.bitrate_bit_s * allowed / 100.0)
            what = f"the exchange would fill {load:.0f} % of {spec} in the worst case, {allowed:.0f} % are allowed"
            advice = f"set sync_period_s to at least {math.ceil(period_s * 1e4) / 1e4:.4f}"
            raise BusOverload(what, advice=advice)

    def _for_each(self, action: Callable[[Cia402Drive], object]) -> None:
        """Do something with every drive, then raise what failed of all of them."""
        failures: list[DriveError] = []
        for drive in self.drives:
            try:
                action(drive)
            except DriveError as error:
                failures.append(error)
        raise_failures(failures)

    def _require(self, condition: bool, advice: str) -> None:
        if not condition:
            raise ConfigurationRefused("the drives are not ready for this", advice=advice)

    def _parts(self) -> tuple[SyncExchange, Guard]:
        if self._exchange is None or self._guard is None:
            raise ConfigurationRefused("the drives are not configured", advice="connect() and configure() first")
        return self._exchange, self._guard

    # -- moving ------------------------------------------------------------------------------------------------------

    def enable(self) -> Epoch:
        """Bring every axis to OPERATION ENABLED, where it holds the position it is at.

        Returns
        -------
        Epoch
            The last one; complete, every axis enabled.

        Raises
        ------
        DriveFault, TransitionTimeout, IncompleteEpochs, SeveralFailures
            What failed; all axes are disabled again. A drive in FAULT is refused and never reset.
        """
        exchange, guard = self._parts()
        self._require(self._configured and not self.enabled, "configure() first, and enable() once")
        self._for_each(lambda drive: starting.refuse_fault(drive, guard))
        try:
            return self._enable(exchange, guard)
        except BaseException as error:
            self._after(error, stopping.disable)
            raise

    def _enable(self, exchange: SyncExchange, guard: Guard) -> Epoch:
        self._for_each(lambda drive: drive.arm(self._master_node_id))
        guard.forgive()
        exchange.restart()
        self._producer.start(exchange.sync_time_s)
        self._running = True
        for drive in self.drives:
            send_nmt(self._bus, NmtCommand.START, drive.node_id)
        epoch = starting.first_epoch(exchange)
        readings = {reading.node_id: reading for reading in epoch.readings if reading is not None}
        self._for_each(lambda drive: starting.compare_with_sdo(drive, readings[drive.node_id]))
        exchange.clock.restart()
        epoch = starting.walk_up(exchange, guard, exchange.cycle(None))
        for drive in self.drives:
            if not drive.setup.profile.state_machine.mode_before_enable:
                bringup.check_mode(drive.access, Mode.CYCLIC_SYNC_POSITION)
        self.enabled = True
        delay_s = max(setup.profile.state_machine.brake_delay_s for setup in self.setups)
        for _ in range(math.ceil(delay_s / self.timing.period_s)):
            epoch = self.hold()
        while not epoch.complete:
            epoch = self.hold()
        return epoch

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

    def reset_fault(self, node_id: int) -> None:
        """Reset the fault of one drive, because a person has removed its cause and says so; the axis stays disabled.

        Raises
        ------
        DriveFault
            The fault is still there.
        """
        self._require(not self._running, "disable() first")
        drive = next((each for each in self.drives if each.node_id == node_id), None)
        if drive is None:
            raise NodeMissing("is not connected", node=node_id, advice="connect() first")
        starting.reset_fault(drive)

    def restore(self) -> None:
        """Put back every object that the ledger holds of the connected drives.

        Raises
        ------
        SeveralFailures or DriveError
            What could not be put back; it stays in the ledger.
        """
        self._require(bool(self.drives) and not self._running, "connect() first, and disable() before restoring")
        failures: list[DriveError] = []
        for drive in self.drives:
            try:
                failures += drive.access.restore()
            except DriveError as error:
                failures.append(error)
        self._close_exchange()
        raise_failures(failures)

    def close(self) -> None:
        """Disable if enabled, leave the drives in PRE-OPERATIONAL, stop listening; may be called again."""
        try:
            self.disable()
        finally:
            self._producer.stop()
            try:
                for drive in self.drives if self._exchange is not None else ():
                    send_nmt(self._bus, NmtCommand.ENTER_PREOPERATIONAL, drive.node_id)
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

    def _forget(self) -> None:
        self._close_exchange()
        for drive in self.drives:
            self._bus.unsubscribe(EMCY_BASE + drive.node_id, self._emcy.on_frame)
            drive.close()
        self.drives = ()

    def _close_exchange(self) -> None:
        for listener in (self._watch, self._exchange):
            if listener is not None:
                listener.close()
        self._watch = self._exchange = self._guard = None
        self._configured = False

    # -- looking back ------------------------------------------------------------------------------------------------

    @property
    def bus(self) -> Bus:
        """The bus that the drives are on."""
        return self._bus

    @property
    def access(self) -> tuple[ObjectAccess, ...]:
        """SDO access to each drive, in the order of the axes."""
        return tuple(drive.access for drive in self.drives)

    @property
    def sync_index(self) -> int:
        """Number of the last SYNC."""
        return 0 if self._exchange is None else self._exchange.sync_index

    @property
    def sync_sent_s(self) -> float:
        """Monotonic time of the last SYNC."""
        return 0.0 if self._exchange is None else self._exchange.sent_s

    def align(self, at_s: float) -> None:
        """By the clock: the next SYNC is due at a monotonic time, so that several groups keep one rhythm."""
        exchange, _ = self._parts()
        exchange.clock.restart(at_s)

    @property
    def statistics(self) -> GroupStatistics:
        """Counters and latencies so far."""
        return group_statistics(self._bus, self.drives, self._exchange, self._emcy)


def _silence_s(setup: AxisSetup) -> float | None:
    """Longest silence of a drive's heartbeat: three times its period."""
    producer_ms = setup.profile.heartbeat.producer_ms
    return None if producer_ms is None else max(_SHORTEST_SILENCE_S, 3.0 * producer_ms / 1000.0)
