"""Drives and measuring devices of one arm while nothing moves: their state before power, and how it is put back."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Self, TypeVar

from drives import stopping
from drives.access import ObjectAccess
from drives.bus import Bus
from drives.busload import cycle_bits_worst
from drives.drive import AxisSetup, Cia402Drive
from drives.emcy import EmcyLog
from drives.errors import ConfigurationRefused, DriveError, ForeignMaster, raise_failures
from drives.exchange import GroupOptions, Pacing, Timing
from drives.heartbeat import MASTER_NODE_ID, HeartbeatProducer
from drives.instrument import Instrument
from drives.ledger import KnownDevice, LedgerEntry, WriteLedger
from drives.other_pdos import OtherPdo

Node = Cia402Drive | Instrument
NodeKind = TypeVar("NodeKind", bound=Node)


class Nodes:
    """Nodes that share one SYNC; `drives.bringup` finds and configures them, `drives.group.DriveGroup` moves them.

    Parameters
    ----------
    bus : Bus
    setups : sequence of AxisSetup
        One per axis, in the order of all commands and readings.
    sync_period_s : float
        Time between two SYNCs; in lockstep the simulated time of one SYNC.
    pacing : "lockstep" or "real"
        Next SYNC as soon as all have answered, or in real time.
    options : GroupOptions, optional

    Attributes
    ----------
    drives : tuple of Cia402Drive
        In the order of the axes; empty before they were found.
    instruments : tuple of Instrument
    failures_found : list of DriveError
        Why nodes cannot be used, as they were found.
    taken_down : tuple of str
        What `restore` read of each drive that it found energised and disabled.

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
        options: GroupOptions | None = None,
    ) -> None:
        self.options = options or GroupOptions()
        ids = [setup.node_id for setup in (*setups, *self.options.instruments)]
        if not setups or len({*ids, MASTER_NODE_ID}) != len(ids) + 1:
            what = f"node ids {ids} and {MASTER_NODE_ID} of the master must each be given once"
            raise ConfigurationRefused(what, advice="correct the cell")
        if not (math.isfinite(sync_period_s) and sync_period_s > 0):
            raise ConfigurationRefused(f"SYNC period {sync_period_s} s is not positive", advice="correct the cell")
        self.bus = bus
        self.setups = tuple(setups)
        self.node_ids = tuple(ids)
        self.timing = Timing(sync_period_s, pacing, self.options)
        consumer_s = min(setup.profile.heartbeat.consumer_ms for setup in setups) / 1000.0
        guarded = [each.node_id for each in setups if each.profile.heartbeat.watchdog == "node guarding"]
        #: Of the master.
        self.heartbeat = HeartbeatProducer(bus, consumer_s, lambda: self.sync_index * sync_period_s, guarded)
        self.ledger = WriteLedger(self.options.ledger_path)
        self.emcy = EmcyLog({setup.node_id: setup.profile for setup in setups})
        self.drives: tuple[Cia402Drive, ...] = ()
        self.instruments: tuple[Instrument, ...] = ()
        self.failures_found: list[DriveError] = []
        self.taken_down: tuple[str, ...] = ()

    @property
    def sync_index(self) -> int:
        """Return the number of the last SYNC; 0 before the exchange."""
        return 0

    def close(self) -> None:
        """Stop listening to the nodes, which have to be found again."""
        self.emcy.close()
        self.heartbeat.stop()
        for node in self.all:
            node.access.sdo.close()
        self.drives, self.instruments, self.failures_found = (), (), []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close()

    @property
    def all(self) -> tuple[Node, ...]:
        """Return the drives, then the measuring devices."""
        return (*self.drives, *self.instruments)

    @property
    def access(self) -> tuple[ObjectAccess, ...]:
        """Return the SDO access to each drive, in the order of the axes."""
        return tuple(drive.access for drive in self.drives)

    @property
    def left_pdos(self) -> tuple[OtherPdo, ...]:
        """Return the PDOs that the gateway does not use and that stay on, as far as it is known."""
        return tuple(pdo for node in self.all for pdo in node.left_pdos)

    @property
    def cycle_bits(self) -> int:
        """Return the worst-case bits of one SYNC cycle, including those of PDOs that stay on."""
        sizes = [0, *(size for node in self.all for _, size in node.answers)]
        sizes += [plan.size_bytes for drive in self.drives for plan in drive.commands]
        sizes += [size for pdo in self.left_pdos if (size := pdo.cyclic_bytes) is not None]
        return cycle_bits_worst(sizes)

    def each(self, action: Callable[[Node], object]) -> None:
        """Call a function for every drive, then for every measuring device; raise all failures together.

        Raises
        ------
        ForeignMaster
            At once: nothing more is sent.
        """
        raise_failures(self.failures(action, self.all))

    def failures(self, action: Callable[[NodeKind], object], nodes: Sequence[NodeKind]) -> list[DriveError]:
        """Call a function for every node; return all failures, but raise `ForeignMaster` as `each` does."""
        failures: list[DriveError] = []
        for node in nodes:
            try:
                action(node)
            except ForeignMaster:
                raise
            except DriveError as error:
                failures.append(error)
        return failures

    # -- putting back ------------------------------------------------------------------------------------------------

    @property
    def noted(self) -> tuple[LedgerEntry, ...]:
        """Return the ledger entries of these nodes, replaced and absent devices included."""
        present = {node.node_id: node.access.device for node in self.all}
        here = [present.get(node_id, KnownDevice(node_id, self.bus.spec.name)) for node_id in self.node_ids]
        return tuple(
            entry
            for entry in self.ledger.entries
            if any(entry.is_of(each) or (entry.node_id, entry.bus) == (each.node_id, each.bus) for each in here)
        )

    def restore(self) -> None:
        """Disable drives that an interrupted run left energised, then restore every object that is in the ledger.

        What was read of a drive that was disabled is in `taken_down`.

        Raises
        ------
        SeveralFailures or DriveError
            Drives that were not disabled, and objects that could not be restored; they stay in the ledger.
        """
        taken_down: list[str] = []
        clock = self.timing.clock(self.bus)
        failures = self.failures(lambda drive: taken_down.append(stopping.take_down(drive, clock)), self.drives)
        self.taken_down = tuple(filter(None, taken_down))
        restored: list[DriveError] = []
        failures += self.failures(lambda node: restored.extend(node.access.restore()), self.all)
        raise_failures(failures + restored)
