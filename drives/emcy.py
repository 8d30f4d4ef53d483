"""Emergency messages (CiA 301, 7.2.7), also those that are shorter than eight bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from drives.bus import Bus, Handler
from drives.profile import DriveProfile

#: Messages kept; `EmcyLog.count` counts all of them.
KEPT: Final = 256

#: Classes of error codes (CiA 301, table 26; CiA 402-1, error codes).
_CLASSES: Final = (
    (0xFF00, 0x0000, "error reset or no error"),
    (0xFF00, 0x1000, "generic error"),
    (0xF000, 0x2000, "current"),
    (0xF000, 0x3000, "voltage"),
    (0xF000, 0x4000, "temperature"),
    (0xFF00, 0x5000, "device hardware"),
    (0xF000, 0x6000, "device software"),
    (0xF000, 0x7000, "additional modules"),
    (0xFF00, 0x8100, "communication"),
    (0xFF00, 0x8200, "protocol"),
    (0xFF00, 0x8600, "positioning"),
    (0xF000, 0x8000, "monitoring"),
    (0xFF00, 0x9000, "external error"),
    (0xFF00, 0xF000, "additional functions"),
    (0xFF00, 0xFF00, "device specific"),
)


@dataclass(frozen=True, slots=True)
class Emergency:
    """One emergency message.

    Attributes
    ----------
    node_id : int
    sync_index : int
        SYNC after which it was received.
    code : int or None
        Error code; None when the frame was too short to hold one.
    register : int or None
        Error register 0x1001.
    vendor : bytes
        Up to five bytes with a meaning defined by the vendor.
    text, advice : str
        From the drive's profile or from the class of the code.
    is_harmless : bool
        The axes go on: it reports an error reset, or the profile lists it as a warning.
    """

    node_id: int
    sync_index: int
    code: int | None
    register: int | None
    vendor: bytes
    text: str
    advice: str
    is_harmless: bool

    @property
    def what(self) -> str:
        """Return the error code and its meaning."""
        code = "short frame" if self.code is None else f"0x{self.code:04X}"
        return f"{code}, {self.text}"

    def __str__(self) -> str:
        text = f"node {self.node_id}: EMCY {self.what}"
        return f"{text}; {self.advice}" if self.advice else text


def parse_emergency(node_id: int, data: bytes, sync_index: int, profile: DriveProfile | None = None) -> Emergency:
    """Read an emergency frame of any length.

    Parameters
    ----------
    node_id : int
        Sender.
    data : bytes
        0 to 8 bytes: code (u16), error register (u8), five vendor bytes.
    sync_index : int
        SYNC after which it came.
    profile : DriveProfile, optional
        Its table of codes takes precedence over the classes of the standard.
    """
    code = int.from_bytes(data[:2], "little") if len(data) >= 2 else None
    register = data[2] if len(data) >= 3 else None
    entry = None if profile is None or code is None else profile.emcy_entry(code)
    if entry is not None:
        text, advice = entry.text, entry.advice
    elif code is None:
        text, advice = "frame too short for an error code", "read 0x603F and the error history 0x1003"
    else:
        text, advice = code_class(code), ""
    is_harmless = code is not None and code & 0xFF00 == 0 or entry is not None and entry.warning
    return Emergency(node_id, sync_index, code, register, bytes(data[3:8]), text, advice, is_harmless)


def code_class(code: int) -> str:
    """Return the text of the class of an error code."""
    return next((text for mask, value, text in _CLASSES if code & mask == value), "unknown class")


class EmcyLog:
    """Bounded log of the EMCY messages of several nodes, newest last."""

    def __init__(self, profiles: Mapping[int, DriveProfile]) -> None:
        self.count = 0
        self.sync_index = 0
        self._profiles = profiles
        self._subscribed: list[tuple[Bus, int, Handler]] = []
        self._kept: deque[Emergency] = deque(maxlen=KEPT)

    @property
    def messages(self) -> tuple[Emergency, ...]:
        """Return the last `KEPT` messages."""
        return tuple(self._kept)

    def listen(self, bus: Bus, node_id: int, can_id: int) -> None:
        """Store the messages of a node that come with this identifier, until `close`."""

        def on_frame(_can_id: int, data: bytes | bytearray, time_s: float) -> None:
            self.on_frame(node_id, data, time_s)

        bus.subscribe(can_id, on_frame)
        self._subscribed.append((bus, can_id, on_frame))

    def close(self) -> None:
        """Stop receiving; what was stored is kept."""
        for bus, can_id, on_frame in self._subscribed:
            bus.unsubscribe(can_id, on_frame)
        self._subscribed.clear()

    def on_frame(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        """Store the EMCY message of a received frame."""
        node_id = can_id & 0x7F
        self.count += 1
        self._kept.append(parse_emergency(node_id, bytes(data), self.sync_index, self._profiles.get(node_id)))

    def last(self, node_id: int) -> Emergency | None:
        """Return the newest message of a node that is not harmless."""
        return next((each for each in reversed(self._kept) if each.node_id == node_id and not each.is_harmless), None)

    def last_clause(self, node_id: int) -> str:
        """Return the newest message of a node that is not harmless, as a clause that ends an error message."""
        last = self.last(node_id)
        return "" if last is None else f"; last emergency: {last.what}{f' ({last.advice})' if last.advice else ''}"
