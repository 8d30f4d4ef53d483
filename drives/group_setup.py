"""Discover, configure and restore the drives of one arm while nothing moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from drives import discovery, stopping
from drives.access import ObjectAccess
from drives.admission import Admission, EmergencyListener
from drives.bus import SYNC_ID, Bus
from drives.busload import frame_bits_worst, load_percent
from drives.cia402 import ENABLE_OPERATION
from drives.drive import AxisSetup, Cia402Drive, Identity
from drives.emcy import EmcyLog
from drives.errors import (
    BusOverload,
    ConfigurationRefused,
    DriveError,
    ForeignMaster,
    NodeMissing,
    raise_failures,
)
from drives.exchange import Pacing, SyncExchange, Timing
from drives.foreign_master import FREE_S, refuse_foreign
from drives.gate import Gate
from drives.guard import Guard, Limits
from drives.heartbeat import MASTER_NODE_ID, HeartbeatProducer, HeartbeatWatch
from drives.instrument import Instrument, InstrumentSetup
from drives.ledger import KnownDevice, LedgerEntry, WriteLedger, without_shared_serials
from drives.reactions import DRIVE_RULES
from drives.statistics import GroupStatistics, group_statistics

_SHORTEST_LISTENING_S: Final = DRIVE_RULES["heartbeat_lost"].limit
#: Lockstep: time for the simulator to process a SYNC.
_SYNC_PAUSE_S: Final = 0.002


@dataclass(frozen=True, slots=True)
class GroupOptions:
    """Times and limits of a group; the defaults suit six drives.

    Attributes
    ----------
    ledger_path : Path, optional
        File of the write ledger, for a restore after a crash.
    answer_timeout_s, gap_timeout_s, window : float
        As in `drives.exchange.Timing`.
    unanswered_syncs : int or None
        As in `drives.guard.Limits`; None = as the table of reactions says.
    foreign_frames : int
        As in `drives.guard.Limits`.
    load_limit_percent : float
        Real time: largest planned worst-case bus load.
    instruments : tuple of InstrumentSetup
        Measuring devices on the same bus, read at each SYNC.
    allow_real_drive : bool
        A real drive may be driven over a network interface (udp_multicast, virtual, socketcand), although any computer
        there can send frames. Lockstep stays refused.
    """

    ledger_path: Path | None = None
    answer_timeout_s: float = 1.0
    gap_timeout_s: float = 0.02
    window: float = 0.9
    unanswered_syncs: int | None = None
    foreign_frames: int = DRIVE_RULES["foreign_master"].count
    load_limit_percent: float = 70.0
    instruments: tuple[InstrumentSetup, ...] = ()
    allow_real_drive: bool = False


class DriveSetup:
    """Discovery, configuration and restore of the drives that share one SYNC; `drives.group.DriveGroup` moves them.

    Parameters
    ----------
    bus : Bus
    setups : sequence of AxisSetup
        One per axis, in the order of all commands and readings.
    sync_period_s : float
        Time between two SYNCs; in lockstep the simulated time of one SYNC.
    pacing : "lockstep" or "real"
        Next SYNC as soon as all have answered, or in real time.
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
        master_node_id: int = MASTER_NODE_ID,
        options: GroupOptions | None = None,
    ) -> None:
        self.options = options or GroupOptions()
        ids = [setup.node_id for setup in (*setups, *self.options.instruments)]
        if not setups or len({*ids, master_node_id}) != len(ids) + 1:
            raise ConfigurationRefused(
                f"node ids {ids} and {master_node_id} of the master must each be given once", advice="correct the cell"
            )
        if not (math.isfinite(sync_period_s) and sync_period_s > 0):
            raise ConfigurationRefused(f"SYNC period {sync_period_s} s is not positive", advice="correct the cell")
        self.setups = tuple(setups)
        self.timing = Timing(
            sync_period_s, pacing, self.options.answer_timeout_s, self.options.gap_timeout_s, self.options.window
        )
        self.ledger = WriteLedger(self.options.ledger_path)
        self.drives: tuple[Cia402Drive, ...] = ()
        self.instruments: tuple[Instrument, ...] = ()
        #: What `restore` read of each drive that it found energised and disabled.
        self.taken_down: tuple[str, ...] = ()
        #: Text about PDOs that the gateway does not use and must not switch off, as found by `configure`.
        self.left_pdos: tuple[str, ...] = ()
        #: Every axis is in OPERATION ENABLED and follows `exchange`.
        self.enabled = False
        #: Called before the axes are stopped because of an error, so that other arms stop in the same cycle.
        self.on_stop: Callable[[], None] = lambda: None
        self._bus = bus
        self._master_node_id = master_node_id
        consumer_s = min(setup.profile.heartbeat.consumer_ms for setup in setups) / 1000.0
        self._producer = HeartbeatProducer(bus, master_node_id, consumer_s)
        self._emcy = EmcyLog({setup.node_id: setup.profile for setup in setups})
        self._emcy_ears = EmergencyListener(bus, self._emcy)
        self._watch: HeartbeatWatch | None = None
        self._exchange: SyncExchange | None = None
        self._guard: Guard | None = None
        self._gate: Gate | None = None
        self._running = self._configured = False
        self._enable_controlwords = (ENABLE_OPERATION,) * len(setups)
        bus.add_chore(self._beat)

    def _beat(self) -> None:
        self._producer.tick(0.0 if self._exchange is None else self._exchange.sync_time_s)

    # -- discovery and setting up --------------------------------------------------------------------------------------

    def connect(self) -> tuple[Identity, ...]:
        """Find every drive and compare it with its profile; no object is written.

        Raises
        ------
        NodeMissing, DuplicateNode, IdentityMismatch, SeveralFailures
            All problems of all drives at once.
        ConfigurationRefused
            Lockstep, or a network as the bus, with a real drive; emergency messages switched off.
        ForeignMaster
            Another master is active on the bus; nothing was sent.
        """
        identities, failures = self._find()
        if not failures:
            admission = Admission(self._bus.spec, self.timing.pacing, self.options.allow_real_drive)
            failures = self._failures(admission.check, admission.check)
        if not failures:
            taken = {can_id for node in (*self.drives, *self.instruments) for can_id, _ in node.answers}
            failures = self._failures(lambda drive: self._emcy_ears.add(drive.access, taken))
        if failures:
            self._forget()
            raise_failures(failures)
        return identities

    def connect_for_restore(self) -> list[DriveError]:
        """Connect as `connect` does, but skip drives that do not respond or have another identity than expected.

        Returns
        -------
        list of DriveError
            Reason of each skipped drive.

        Raises
        ------
        ForeignMaster
            Another master is active on the bus; nothing was sent.
        """
        _, failures = self._find()
        absent = {failure.node for failure in failures}
        for node in (*self.drives, *self.instruments):
            if node.node_id in absent:
                node.close()
        self.drives = tuple(drive for drive in self.drives if drive.node_id not in absent)
        self.instruments = tuple(device for device in self.instruments if device.node_id not in absent)
        return failures

    def _find(self) -> tuple[tuple[Identity, ...], list[DriveError]]:
        """Read the identity of every node, and collect the failures of all of them."""
        self._forget()
        refuse_foreign(self._bus, max(FREE_S, 3.0 * self.timing.period_s), self._master_node_id)
        timeout_s = max(setup.profile.sdo.timeout_s for setup in self.setups)
        answers = discovery.count_answers(self._bus, [setup.node_id for setup in self.setups], timeout_s)
        self.drives = tuple(Cia402Drive(self._bus, setup, self.ledger) for setup in self.setups)
        self.instruments = tuple(Instrument(self._bus, setup, self.ledger) for setup in self.options.instruments)
        identities: list[Identity] = []
        not_responding = [node_id for node_id, number in answers.items() if number == 0]
        try:
            states = discovery.nmt_states(self._bus, not_responding)

            def identify(drive: Cia402Drive) -> None:
                identities.append(discovery.identify(drive, answers[drive.node_id], states.get(drive.node_id)))

            failures = self._failures(identify, Instrument.identify)
        except DriveError:
            self._forget()
            raise
        accesses = [node.access for node in (*self.drives, *self.instruments)]
        devices = without_shared_serials([access.device for access in accesses])
        for access, device in zip(accesses, devices, strict=True):
            access.device = device
        return tuple(identities), failures

    def configure(self) -> None:
        """Map the PDOs, set mode, period, heartbeats and the reaction to a lost master; everything is read back.

        Raises
        ------
        BusOverload
            Real time: the planned bus load exceeds the limit.
        SeveralFailures or DriveError
            Failures of all drives at once.
        """
        self._require(bool(self.drives) and not self._running, "connect() first, and do not configure while enabled")
        first_index = 0 if self._exchange is None else self._exchange.sync_index
        self._close_exchange()
        self._for_each(lambda node: node.access.refuse_unfinished(), lambda node: node.access.refuse_unfinished())
        self._for_each(lambda node: node.access.adopt_applied(), lambda node: node.access.adopt_applied())
        exchange = SyncExchange(self._bus, self.drives, self.timing, self._producer, first_index, self.instruments)
        try:
            self._for_each(Cia402Drive.survey, Instrument.survey)
            planned_bits = exchange.cycle_bits
            self._check_load(exchange, planned_bits)
            period_s = self.timing.period_s
            self._for_each(lambda drive: drive.configure(period_s), lambda device: device.configure(period_s))
            self._check_load(exchange, planned_bits)
            self._for_each(Cia402Drive.disarm)
            self.ledger.settle()
        except BaseException:
            exchange.close()
            raise
        limits = [_listening_s(drive.setup) for drive in self.drives]
        node_ids = [drive.node_id for drive in self.drives]
        watch = HeartbeatWatch(self._bus, node_ids, limits, lambda: exchange.sync_time_s)
        self._exchange, self._watch = exchange, watch
        unanswered = self.options.unanswered_syncs or DRIVE_RULES["silent"].syncs(
            self.timing.period_s, self.timing.pacing
        )
        guard_limits = Limits(unanswered, self.options.foreign_frames)
        self._guard = Guard(self._bus, exchange, watch, self._emcy, guard_limits)
        self._gate = Gate(self._bus, self.drives, watch, self._emcy)
        self._configured = True

    def _check_load(self, exchange: SyncExchange, planned_bits: int) -> None:
        """Refuse a worst-case bus load above the limit, including PDOs that cannot be switched off."""
        left = [pdo for node in (*self.drives, *self.instruments) for pdo in node.left_pdos]
        self.left_pdos = tuple(str(pdo) for pdo in left)
        sizes = [size for pdo in left if (size := pdo.cyclic_bytes) is not None]
        exchange.cycle_bits = planned_bits + sum(frame_bits_worst(size) for size in sizes)
        spec, allowed = self._bus.spec, self.options.load_limit_percent
        load = load_percent(exchange.cycle_bits, self.timing.period_s, spec.bitrate_bit_s)
        if self.timing.pacing == "real" and load > allowed:
            period_s = exchange.cycle_bits / (spec.bitrate_bit_s * allowed / 100.0)
            what = f"the exchange would fill {load:.0f} % of {spec} in the worst case, {allowed:.0f} % are allowed"
            advice = f"set sync_period_s to at least {math.ceil(period_s * 1e4) / 1e4:.4f}"
            raise BusOverload(what, advice=advice)

    def _for_each(
        self, action: Callable[[Cia402Drive], object], beside: Callable[[Instrument], object] = lambda _: None
    ) -> None:
        """Call a function for every drive, then for every instrument; raise all failures together."""
        raise_failures(self._failures(action, beside))

    def _failures(
        self, action: Callable[[Cia402Drive], object], beside: Callable[[Instrument], object] = lambda _: None
    ) -> list[DriveError]:
        """Call a function for every drive, then for every instrument; return all failures.

        Raises
        ------
        ForeignMaster
            At once: nothing more is sent.
        """
        failures: list[DriveError] = []
        jobs = [partial(action, drive) for drive in self.drives]
        for job in (*jobs, *(partial(beside, instrument) for instrument in self.instruments)):
            try:
                job()
            except ForeignMaster:
                raise
            except DriveError as error:
                failures.append(error)
        return failures

    def _require(self, condition: bool, advice: str) -> None:
        if not condition:
            raise ConfigurationRefused("the drives are not ready for this", advice=advice)

    def _parts(self) -> tuple[SyncExchange, Guard]:
        if self._exchange is None or self._guard is None:
            raise ConfigurationRefused("the drives are not configured", advice="connect() and configure() first")
        return self._exchange, self._guard

    # -- putting back ------------------------------------------------------------------------------------------------

    def reset_fault(self, node_id: int) -> None:
        """Reset the fault of one drive at the request of a person who has removed its cause; the axis stays disabled.

        Raises
        ------
        DriveFault
            The fault is still there.
        """
        self._require(not self._running, "disable() first")
        drive = next((each for each in self.drives if each.node_id == node_id), None)
        if drive is None:
            raise NodeMissing("is not connected", node=node_id, advice="connect() first")
        drive.reset_fault()

    def restore(self) -> None:
        """Disable drives that an interrupted run left energised, then restore every object that is in the ledger.

        What was read of a drive that was disabled is in `taken_down`.

        Raises
        ------
        SeveralFailures or DriveError
            Drives that were not disabled, and objects that could not be restored; they stay in the ledger.
        """
        self._require(not self._running, "disable() before restoring")
        self._require(bool(self.drives or self.instruments), "connect() first")
        failures: list[DriveError] = []
        taken_down: list[str] = []
        failures += self._failures(lambda drive: taken_down.append(stopping.take_down(drive, self._pause)))
        self.taken_down = tuple(filter(None, taken_down))

        def put_back(node: Cia402Drive | Instrument) -> None:
            failures.extend(node.access.restore())

        failures += self._failures(put_back, put_back)
        self._close_exchange()
        raise_failures(failures)

    def _pause(self, seconds: float) -> None:
        """Wait; in lockstep a simulated drive goes on only with SYNC."""
        if self.timing.pacing == "real":
            self._bus.listen(seconds)
            return
        for _ in range(math.ceil(seconds / self.timing.period_s)):
            self._bus.send(SYNC_ID, b"")
            self._bus.listen(_SYNC_PAUSE_S)

    @property
    def noted(self) -> tuple[LedgerEntry, ...]:
        """Return the ledger entries of this group's nodes, replaced and absent devices included."""
        present = {node.node_id: node.access.device for node in (*self.drives, *self.instruments)}
        ids = [setup.node_id for setup in (*self.setups, *self.options.instruments)]
        here = [present.get(node_id, KnownDevice(node_id, self._bus.spec.name)) for node_id in ids]
        return tuple(
            entry
            for entry in self.ledger.entries
            if any(entry.is_of(each) or (entry.node_id, entry.bus) == (each.node_id, each.bus) for each in here)
        )

    def _forget(self) -> None:
        self._close_exchange()
        self._emcy_ears.close()
        for drive in self.drives:
            drive.close()
        for instrument in self.instruments:
            instrument.close()
        self.drives, self.instruments = (), ()

    def _close_exchange(self) -> None:
        for listener in (self._watch, self._exchange):
            if listener is not None:
                listener.close()
        self._watch = self._exchange = self._guard = self._gate = None
        self._configured = False

    # -- looking back ------------------------------------------------------------------------------------------------

    @property
    def bus(self) -> Bus:
        """Return the bus of the drives."""
        return self._bus

    @property
    def access(self) -> tuple[ObjectAccess, ...]:
        """Return the SDO access to each drive, in the order of the axes."""
        return tuple(drive.access for drive in self.drives)

    @property
    def sync_index(self) -> int:
        """Return the number of the last SYNC."""
        return 0 if self._exchange is None else self._exchange.sync_index

    @property
    def sync_sent_s(self) -> float:
        """Return the monotonic time of the last SYNC [s]."""
        return 0.0 if self._exchange is None else self._exchange.sent_s

    def align(self, at_s: float) -> None:
        """Real time: set when the next SYNC is due (monotonic), so that several groups share one phase."""
        exchange, _ = self._parts()
        exchange.clock.restart(at_s)

    @property
    def statistics(self) -> GroupStatistics:
        """Return the counters and latencies so far."""
        return group_statistics(self._bus, self.drives, self._exchange, self._emcy)


def _listening_s(setup: AxisSetup) -> float | None:
    """Return the allowed gap in a drive's heartbeat: three times its period [s]; None = no heartbeat."""
    producer_ms = setup.profile.heartbeat.producer_ms
    return None if producer_ms is None else max(_SHORTEST_LISTENING_S, 3.0 * producer_ms / 1000.0)
