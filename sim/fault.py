"""A fault of a simulated drive or of its wire, and what every kind of fault states of itself.

The kinds are in one table, `sim.faults.KINDS`; what they do is in `sim.drive_faults` and `sim.wire_faults`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Where = Literal["object", "drive", "mechanics", "wire", "master"]
Starts = Literal["power-up", "between runs", "in brakes", "any time", "load taken over", "slow motion", "in motion"]
Reaction = Literal["goes on", "retried", "stops", "refuses", "finding", "drive test", "drives stop", "kept"]

#: What each reaction means.
REACTIONS: dict[Reaction, str] = {
    "goes on": "the fault is counted and reported; all samples stay valid",
    "retried": "the SYNCs concerned are reported as incomplete and their samples are measured again",
    "stops": "every axis makes a controlled stop; recorded data is kept; motion does not resume by itself",
    "refuses": "no axis moves; an error names the node and the object",
    "finding": "the pre-flight check or the data quality report shows a finding with a remedy",
    "drive test": "the test of the drives shows a finding of this drive and of no other",
    "drives stop": "every drive stops by itself (heartbeat consumer), whatever the master does",
    "kept": "the run ends with an error; every finished pose visit is on disk",
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, with the parameters that its kind has; made by `sim.faults.fault_of`.

    Attributes
    ----------
    kind : one of `sim.faults.KINDS`
    node : node id; 0 = every node, or no node in particular
    at_sync : SYNC at which the fault starts
    syncs : duration in SYNCs; 0 = until the end
    count : maximum number of affected frames, 0 = all; SYNCs until `enables_and_drops` acts
    delay_s : delay of frames, duration of a burst, or time until a refused START is obeyed [s]
    index, subindex : object that the fault affects; index 0 = any object of the kind
    code : EMCY code, SDO abort code, value, size or highest subindex of the affected object, bits of the statusword
    low, high : values that the affected object accepts
    share : share of frames that are lost at random, 0 to 1
    rate_hz : rate of a flooding TPDO [Hz]
    speed_rad_s : speed at which the axis drops with its brake closed [rad/s]
    accel_rad_s2 : acceleration with which the axis falls with its brake closed [rad/s2]
    seed : seed of the random choice
    """

    kind: str
    node: int = 0
    at_sync: int = 0
    syncs: int = 1
    count: int = 0
    delay_s: float = 0.0
    index: int = 0
    subindex: int = 0
    code: int = 0
    low: int = 0
    high: int = 0
    share: float = 1.0
    rate_hz: float = 0.0
    speed_rad_s: float = 0.0
    accel_rad_s2: float = 0.0
    seed: int = 1

    def active(self, sync: int) -> bool:
        """Return whether the fault is active at SYNC number `sync`."""
        return sync >= self.at_sync and (self.syncs == 0 or sync < self.at_sync + self.syncs)

    def concerns(self, node: int) -> bool:
        """Return whether the fault affects this node."""
        return self.node in (0, node)


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of fault: a row of the table.

    Attributes
    ----------
    where : where it acts
    starts : when it is injected so that the reaction shows; "power-up": before a master connects
    reaction : what the master must do
    bound : SYNCs allowed from the start to the reaction; None = not counted in SYNCs (before motion, or in real time)
    hook : what it does. Of the wire: (wire, armed fault, frame) -> frames in its place, None = not touched.
        Of a drive: (drive, fault) -> None, undone by `FakeDrive.repair`. None = a fault of the master.
    touches : of the wire, groups of CAN identifiers that pass the hook
    defaults : its parameters beside node, time, count and seed, and other defaults than those of `Fault`
    bound_s : in real time, time allowed from the start to the reaction [s]; None = `bound` SYNCs
    """

    where: Where
    starts: Starts
    reaction: Reaction
    bound: int | None
    hook: Callable[..., Any] | None
    touches: tuple[int, ...]
    defaults: Mapping[str, Any]
    bound_s: float | None = None
