"""Simulated CANopen measuring device after CiA 301 and CiA 404, which exchanges CAN frames with the master.

Process values are in one object, a channel per subindex, with unit (0x6131, coded as CiA 303-2 says), decimal digits
(0x6132) and status (0x6150: bit 0 not valid, bit 1 above, bit 2 below the measuring range). They are sampled at the
SYNC, and every synchronous TPDO shows that one sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can

from sim.device import PDO_COUNT, Device
from sim.objects import LIMITS
from sim.pdo import Pdo

DEVICE_TYPE = 0x0002_0194  # analogue inputs, CiA 404
METRE = 0x01
NOT_VALID, ABOVE, BELOW = 0x01, 0x02, 0x04


@dataclass(frozen=True, slots=True)
class MeasuringSite:
    """Node id and channels of a measuring device.

    Attributes
    ----------
    node_id : on the bus
    index, type : object of the process values, "i16" or "i32"
    status_index : object of the status, or None
    subindices : one per channel
    lsb_m : what one bit means
    range_m : measuring range
    """

    node_id: int
    index: int
    type: str
    status_index: int | None
    subindices: tuple[int, ...]
    lsb_m: float
    range_m: tuple[float, float]


class FakeMeasuringDevice(Device):
    """One device on the bus.

    Parameters
    ----------
    site : MeasuringSite
    measure : gives the distances [m] at the present instant, one per channel
    send : puts a frame on the bus

    Attributes
    ----------
    measure : as given
    """

    def __init__(
        self, site: MeasuringSite, measure: Callable[[], Sequence[float]], send: Callable[[can.Message], None]
    ) -> None:
        super().__init__(site.node_id, send)
        self.site, self.measure = site, measure
        self._words = [0] * len(site.subindices)
        self._status = [NOT_VALID] * len(site.subindices)
        self._fill()
        self.tpdos = [Pdo(self.store, 0x1800 + n, 0x1A00 + n) for n in range(PDO_COUNT)]
        self.connect()
        self.node.on_reset = self.preset_pdos

    def _fill(self) -> None:
        site, store = self.site, self.store
        store.constant((0x1000, 0), "u32", DEVICE_TYPE)
        store.parameter((0x1005, 0), "u32", 0x80)
        store.constant((0x1008, 0), "str", "distance sensors")
        for sub, value in enumerate((4, 0x0000_0051, 0x0000_0404, 0x0001_0000, 0x40_4000 + site.node_id)):
            store.constant((0x1018, sub), "u32" if sub else "u8", value)
        count = max(site.subindices)
        unit = _unit(site.lsb_m)
        if unit is not None:
            store.constant((0x6131, 0), "u8", count)
            store.constant((0x6132, 0), "u8", count)
        store.constant((site.index, 0), "u8", count)
        if site.status_index is not None:
            store.constant((site.status_index, 0), "u8", count)
        for channel, sub in enumerate(site.subindices):
            if unit is not None:
                store.constant((0x6131, sub), "u32", unit[0])
                store.constant((0x6132, sub), "u8", unit[1])
            store.live((site.index, sub), site.type, lambda channel=channel: self._words[channel])
            if site.status_index is not None:
                store.live((site.status_index, sub), "u8", lambda channel=channel: self._status[channel])

    def preset_pdos(self) -> None:
        """Set the default PDO mapping, with all TPDOs invalid until a master enables one."""
        self.preset(self.tpdos, 0x180, [(self.site.index, self.site.subindices[0])], first=False)

    def latch(self) -> None:
        """Sample the channels."""
        low, high = self.site.range_m
        least, most = LIMITS[self.site.type]
        for channel, distance in enumerate(self.measure()):
            known = math.isfinite(distance)
            shown = min(max(distance, low), high) if known else 0.0
            self._words[channel] = min(max(round(shown / self.site.lsb_m), least), most)
            out = (ABOVE if distance > high else BELOW if distance < low else 0) if known else 0
            self._status[channel] = (NOT_VALID if out or not known else 0) | out


def _unit(lsb_m: float) -> tuple[int, int] | None:
    """Return unit code and decimal digits of a resolution that is a power of ten; None for any other."""
    exponent = round(math.log10(lsb_m))
    if not math.isclose(10.0**exponent, lsb_m, rel_tol=1e-9) or exponent > 0:
        return None
    prefix = next(power for power in (0, -3, -6, -9) if power - 3 < exponent <= power or power == -9)
    return (prefix & 0xFF) << 24 | METRE << 16, max(0, prefix - exponent)
