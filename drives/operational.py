"""Send NMT START until every node is OPERATIONAL: a node may refuse it while a communication error is active.

CiA 301 defines no answer to an NMT command. The state is taken from the node's heartbeat or, where the profile sets
none, from its answers to SYNC, which are sent in OPERATIONAL only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from drives.bus import Bus
from drives.drive import Cia402Drive
from drives.epoch import Epoch
from drives.errors import DriveError, HeartbeatLost, NotOperational, raise_failures
from drives.guard import Guard
from drives.heartbeat import HeartbeatWatch, NmtCommand, NmtState, send_nmt
from drives.instrument import Instrument

#: Interval at which START is repeated to a node that is not OPERATIONAL.
REPEAT_S: Final = 0.2
#: How long.
PATIENCE_S: Final = 2.0
#: And no shorter than this many of its heartbeats.
_BEATS: Final = 3.0
_SLICE_S: Final = 0.01


class NmtStart:
    """NMT START of every node of a group, with confirmation.

    Parameters
    ----------
    bus : Bus
    drives : sequence of Cia402Drive
    instruments : sequence of Instrument
        Started too, repeatedly while they do not respond, but not waited for: a row is complete without them.
    watch : HeartbeatWatch
        Of the drives.
    guard : Guard
        Monitors the bus meanwhile, and has the last emergency of each drive.
    """

    def __init__(
        self,
        bus: Bus,
        drives: Sequence[Cia402Drive],
        instruments: Sequence[Instrument],
        watch: HeartbeatWatch,
        guard: Guard,
    ) -> None:
        self._bus, self._watch, self._guard = bus, watch, guard
        self._drives, self._instruments = tuple(drives), tuple(instruments)
        self._began_s = self._sent_s = 0.0

    def begin(self) -> None:
        """Send START to every node; earlier reports of its state are discarded."""
        self._bus.drain()
        for drive in self._drives:
            self._watch.states[drive.node_id] = None
        self._began_s = time.monotonic()
        self._send([node.node_id for node in (*self._drives, *self._instruments)])

    def confirm(self, check_stop: Callable[[], None]) -> None:
        """Wait until every drive whose profile sets a heartbeat reports OPERATIONAL.

        Parameters
        ----------
        check_stop : callable
            Raises when a person has requested a stop.

        Raises
        ------
        NotOperational, HeartbeatLost, SeveralFailures
            Drives that do not report it in time.
        DriveRebooted, ForeignMaster, BusOff
            Other events on the bus meanwhile.
        """
        while waiting := [drive for drive in self._drives if self._beats(drive) and not self._is_up(drive)]:
            if all(time.monotonic() - self._began_s > _patience_s(drive) for drive in waiting):
                raise_failures([self._failure(drive) for drive in waiting])
            self._send_again([drive.node_id for drive in waiting])
            check_stop()
            self._bus.listen(_SLICE_S)
            self._guard.check_bus()

    def again(self, epoch: Epoch) -> bool:
        """Repeat START to nodes that leave SYNC unanswered and did not report OPERATIONAL; return whether to wait for
        them.

        Raises
        ------
        NotOperational, SeveralFailures
            The time for that is over.
        """
        silent = [self._drives[axis] for axis in epoch.missing if not self._is_up(self._drives[axis])]
        if silent and time.monotonic() - self._began_s > PATIENCE_S:
            raise_failures([self._failure(drive) for drive in silent])
        devices = zip(self._instruments, epoch.instruments, strict=True)
        mute = [instrument.node_id for instrument, reading in devices if reading is None]
        self._send_again([*(drive.node_id for drive in silent), *mute])
        return bool(silent)

    def _send_again(self, node_ids: Sequence[int]) -> None:
        if time.monotonic() - self._sent_s >= REPEAT_S:
            self._send(node_ids)

    def _send(self, node_ids: Sequence[int]) -> None:
        for node_id in node_ids:
            send_nmt(self._bus, NmtCommand.START, node_id)
        self._sent_s = time.monotonic()

    def _is_up(self, drive: Cia402Drive) -> bool:
        return self._watch.states[drive.node_id] is NmtState.OPERATIONAL

    @staticmethod
    def _beats(drive: Cia402Drive) -> bool:
        return drive.setup.profile.heartbeat.producer_ms is not None

    def _failure(self, drive: Cia402Drive) -> DriveError:
        state = self._watch.states[drive.node_id]
        if state is None and self._beats(drive):
            what = f"sends no heartbeat, although 0x1017 is {drive.setup.profile.heartbeat.producer_ms} ms"
            advice = "check the drive; leave heartbeat.producer_ms out of the profile if it has no heartbeat"
            return HeartbeatLost(what, node=drive.node_id, index=0x1017, advice=advice)
        said = "its NMT state is not known" if state is None else f"it is in NMT state {str(state).upper()}"
        what = f"does not go to OPERATIONAL, commanded for {PATIENCE_S:.0f} s: {said}"
        what += self._guard.emcy.last_clause(drive.node_id)
        advice = (
            "a communication error may be active: read 0x1001, 0x1003, error behaviour 0x1029 and SYNC period 0x1006"
        )
        return NotOperational(what, node=drive.node_id, advice=f"{advice}; remove its cause, or switch it off and on")


def _patience_s(drive: Cia402Drive) -> float:
    return max(PATIENCE_S, _BEATS * (drive.setup.profile.heartbeat.producer_ms or 0) / 1000.0)
