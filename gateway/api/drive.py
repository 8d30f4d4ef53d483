"""One drive on a bus, read and never written."""

from __future__ import annotations

from types import TracebackType

from drives.bus import BusSpec, open_bus
from drives.discovery import read_identity
from drives.objects import OBJECTS
from drives.sdo import SdoClient
from drives.values import Identity


class Drive:
    """One CANopen drive, read over SDO: nothing is written to it and nothing moves.

    A context manager; `close` releases the bus.

    Parameters
    ----------
    bus : str
        As `--bus`: `INTERFACE:CHANNEL[,key=value]...`, such as `socketcan:can0`.
    node_id : int
        1 to 127.

    Raises
    ------
    BusError
        The bus cannot be opened.
    """

    def __init__(self, bus: str, node_id: int) -> None:
        self._bus = open_bus(BusSpec.parse(bus))
        self._sdo = SdoClient(self._bus, node_id)

    def __enter__(self) -> Drive:
        """Return the drive itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the bus."""
        self.close()

    def close(self) -> None:
        """Release the bus."""
        self._sdo.close()
        self._bus.close()

    def identity(self) -> Identity:
        """Read vendor, product, revision, serial number and versions; None where the drive lacks the object.

        Raises
        ------
        SdoError
            The drive does not respond.
        """
        return read_identity(self._sdo)

    def read(self, name: str) -> int | str:
        """Read one object of CiA 301 or CiA 402 by its name, such as `statusword`: the raw number, or the text.

        Raises
        ------
        KeyError
            No object of this name.
        SdoError
            The drive does not respond, or refuses.
        """
        entry = OBJECTS[name]
        if entry.type == "str":
            return self._sdo.read_text(entry.index, entry.subindex)
        return self._sdo.read(entry.index, entry.subindex, entry.type)
