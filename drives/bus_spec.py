"""Address of a CAN bus: python-can interface, channel, bit rate and options."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

from drives.errors import BusError

#: Interfaces that are a network: any computer on it can send frames to the drives.
NETWORKS: Final = frozenset({"udp_multicast", "virtual", "socketcand"})
#: Options that belong to the address of a bus, and what they are where they are not given.
_ADDRESS: Final = {"port": {"udp_multicast": 43113}, "host": {}}
#: Further options by which python-can's interfaces select one of several adapters.
_ADAPTER: Final = (
    "index", "bus", "address", "device", "device_id", "device_number", "serial", "unique_hardware_id", "app_name"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One bus: python-can interface, channel, bit rate and further options of the interface.

    Attributes
    ----------
    interface, channel : str
        As python-can names them.
    bitrate_bit_s : int
        Of the wire; the planned bus load refers to it also where the interface has no wire.
    options : mapping
        Further arguments of the interface, unchanged.
    """

    interface: str
    channel: str
    bitrate_bit_s: int = 1_000_000
    options: MappingProxyType[str, Any] | dict[str, Any] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> BusSpec:
        """Read ``INTERFACE:CHANNEL[,key=value]...``; the key `bitrate` is the bit rate.

        Raises
        ------
        BusError
            The text does not have that form.
        """
        interface, colon, rest = text.partition(":")
        channel, *pairs = rest.split(",")
        if not (colon and interface.strip() and channel.strip()):
            advice = "write INTERFACE:CHANNEL[,key=value], e.g. udp_multicast:239.74.163.2,port=43113 or socketcan:can0"
            raise BusError(f"bus '{text}' does not have the form INTERFACE:CHANNEL[,key=value]", advice=advice)
        options: dict[str, Any] = {}
        for pair in pairs:
            key, equals, value = pair.partition("=")
            if not (equals and key.strip() and value.strip()):
                raise BusError(
                    f"bus '{text}': option '{pair}' does not have the form key=value", advice="write key=value"
                )
            options[key.strip()] = _typed(value.strip())
        bitrate = options.pop("bitrate", 1_000_000)
        if not isinstance(bitrate, int) or isinstance(bitrate, bool) or bitrate <= 0:
            raise BusError(f"bus '{text}': bitrate must be a positive integer in bit/s", advice="e.g. bitrate=500000")
        return cls(interface.strip(), channel.strip(), bitrate, options)

    @property
    def name(self) -> str:
        """Return the address of the bus, without the options that only affect its use."""
        found = {key: self.options.get(key, known.get(self.interface)) for key, known in _ADDRESS.items()}
        address = [f"{key}={value}" for key, value in found.items() if value is not None]
        return ",".join([f"{self.interface}:{self.channel}", *address])

    @property
    def wire(self) -> str:
        """Return the identity of the bus: interface, channel (a device file without links), port, host and adapter."""
        channel = os.path.realpath(self.channel) if self.channel.startswith("/") else self.channel
        address = self.name.replace(self.channel, channel, 1)
        return ",".join([address, *(f"{key}={self.options[key]}" for key in _ADAPTER if key in self.options)])

    def __str__(self) -> str:
        return ",".join(
            [f"{self.interface}:{self.channel}", *(f"{key}={value}" for key, value in self.options.items())]
        )


def _typed(text: str) -> str | int | float | bool:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (lambda value: int(value, 0), float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text
