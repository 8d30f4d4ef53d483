"""Opening of a CAN adapter from its configuration, and the only receive path of the master.

Besides `frame_log` the only file that imports python-can. The thread that waits for an answer receives, and every frame
goes through one table of handlers, so that no frame waits in a cache. Frames of this master that the adapter echoes
(udp_multicast) are distinguished from frames of another master.
"""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Final, NoReturn

import can

from drives.bus_spec import BusSpec
from drives.errors import BusError, ForeignMaster
from drives.reactions import DRIVE_RULES

__all__ = ["Bus", "BusSpec", "Frame", "Handler", "Tap", "open_bus"]

NMT_ID: Final = 0x000
SYNC_ID: Final = 0x080
EMCY_BASE: Final = 0x080
SDO_REQUEST_BASE: Final = 0x600
SDO_ANSWER_BASE: Final = 0x580
HEARTBEAT_BASE: Final = 0x700

#: Interfaces that echo every sent frame without marking it.
_ECHOING: Final = frozenset({"udp_multicast"})
_WITHOUT_BITRATE: Final = frozenset({"virtual", "udp_multicast", "socketcan"})
#: What an interface needs beside python-can, by its documentation (python-can, "CAN interface modules").
_NEEDS: Final = {
    "slcan": "it needs a Python package: pip install pyserial",
    "serial": "it needs a Python package: pip install pyserial",
    "robotell": "it needs a Python package: pip install pyserial",
    "seeedstudio": "it needs a Python package: pip install pyserial",
    "gs_usb": "it needs Python packages: pip install gs_usb pyusb",
    "cantact": "it needs a Python package: pip install cantact",
    "canalystii": "it needs a Python package: pip install canalystii",
    "nixnet": "it needs the driver NI-XNET and a Python package: pip install nixnet",
    "usb2can": "it needs the driver of the USB2CAN adapter (usb2can.dll)",
    "kvaser": "it needs Kvaser's driver with CANlib (canlib32, libcanlib)",
    "pcan": "it needs PEAK's driver with PCAN-Basic (libpcanbasic)",
    "ixxat": "it needs Ixxat's driver VCI",
    "vector": "it needs Vector's XL driver library",
    "nican": "it needs the driver NI-CAN",
}
_ADVICE: Final = {
    "socketcan": "bring it up: ip link set {channel} txqueuelen 1000 up type can bitrate {bitrate_bit_s}",
    "udp_multicast": "needs msgpack and a multicast address such as 239.74.163.2,port=43113",
}
_NO_KERNEL_CAN: Final = (
    "this kernel has no CAN: load it by `modprobe can_raw`, use a kernel with CONFIG_CAN (containers and WSL often have"
    " none), or an adapter with a driver of its own; `servo-gateway doctor` lists the interfaces"
)
#: How long a full transmit queue is waited for before the send counts as failed.
SEND_TIMEOUT_S: Final = DRIVE_RULES["queue_full"].limit
#: Receptions that may fail in a row (stray datagrams) before the adapter counts as broken.
_RECEIVE_FAILURES: Final = 1000
_CAN_ERROR_BUS_OFF: Final = 0x40
#: Own frames of one id that may be echoed at the same time: NMT commands to every node of a bus.
_ECHO_MEMORY: Final = 128
#: Odd frames that are taken in at once when there is no time left to wait.
_ODD_AT_ONCE: Final = 64
#: Longest time for reading frames that have already arrived [s].
_DRAIN_S: Final = 0.05
#: Interfaces whose frames carry this computer's wall clock, taken when a frame came in (on virtual: was sent).
_STAMPING: Final = frozenset({"socketcan", "udp_multicast", "virtual"})

#: A received or prepared CAN frame.
Frame = can.Message
Handler = Callable[[int, bytes | bytearray, float], None]
#: Takes every frame and whether it was received; it must only store.
Tap = Callable[[Frame, bool], None]


class Bus:
    """An open bus: send, receive, and a table of handlers by CAN id.

    Parameters
    ----------
    adapter : can.BusABC
        The open python-can bus; it is shut down by `close`.
    spec : BusSpec
        What it was opened from.
    """

    def __init__(self, adapter: Any, spec: BusSpec) -> None:
        self.spec = spec
        self.echoes = spec.interface in _ECHOING or bool(spec.options.get("receive_own_messages", False))
        #: Time stamps of frames are this computer's wall clock, and may be compared with it.
        self.stamped = spec.interface in _STAMPING
        #: Frames by what was wrong with them, or whose they were.
        self.counts: Counter[str] = Counter()
        #: Frames of another master by CAN id.
        self.foreign: Counter[int] = Counter()
        #: All of them.
        self.foreign_count = 0
        #: `foreign_count` when this bus was found free; None = it was not listened to, or a run watches it itself.
        self.free_count: int | None = None
        self.bus_off = False
        self.receive_lock = threading.RLock()
        self._adapter = adapter
        self._send_lock = threading.Lock()
        self._handlers: dict[int, tuple[Handler, ...]] = {}
        self._sent: dict[int, int] = {}
        self._chores: list[Callable[[], None]] = []
        self._failures = 0
        self._dispatching: int | None = None
        self._taps: tuple[Tap, ...] = ()
        self._receive: Callable[[float], Any] = adapter.recv
        for can_id in (NMT_ID, SYNC_ID, *range(SDO_REQUEST_BASE + 1, SDO_REQUEST_BASE + 128)):
            self.watch_master_id(can_id)

    # -- receiving ---------------------------------------------------------------------------------------------------

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next data frame with an 11 bit id, or None after the time-out; other frames are only counted.

        The time is a deadline: neither odd frames nor failures of the adapter extend it.

        Raises
        ------
        BusError
            The adapter fails again and again.
        """
        deadline_s = time.monotonic() + timeout_s
        odd = 0
        while True:
            try:
                frame = self._receive(timeout_s)
            except BusError:
                raise
            except Exception as error:  # python-can's backends raise what their libraries raise
                self._on_receive_failure(error)
            else:
                if frame is None:
                    return None
                self._failures = 0
                if self._taps:
                    self._hand_to_taps(frame, received=True)
                if not (frame.is_error_frame or frame.is_remote_frame or frame.is_extended_id):
                    return frame
                self._on_odd_frame(frame)
            odd += 1
            timeout_s = deadline_s - time.monotonic()
            if timeout_s <= 0.0:
                if odd >= _ODD_AT_ONCE:
                    return None
                timeout_s = 0.0

    def _on_receive_failure(self, error: Exception) -> None:
        self.counts["malformed"] += 1
        self._failures += 1
        if self._failures > _RECEIVE_FAILURES:
            advice = "check the adapter and the cable; the drives stop by themselves when the master's heartbeat stops"
            what = f"{self.spec}: receiving failed {self._failures} times: {str(error) or type(error).__name__}"
            raise BusError(what, advice=advice) from error

    def _hand_to_taps(self, frame: Any, *, received: bool) -> None:
        """Pass a frame to every tap; a tap that raises is counted and removed."""
        for tap in self._taps:
            try:
                tap(frame, received)
            except Exception:
                self.counts["taps_failed"] += 1
                self.remove_tap(tap)

    def _on_odd_frame(self, frame: Any) -> None:
        if not frame.is_error_frame:
            self.counts["remote" if frame.is_remote_frame else "extended"] += 1
            return
        self.counts["error"] += 1
        if frame.arbitration_id & _CAN_ERROR_BUS_OFF:
            self.bus_off = True

    def check_free(self) -> None:
        """Raise `ForeignMaster` when another master has sent a frame since this bus was found free."""
        if self.free_count is not None and self.foreign_count != self.free_count:
            number, ids = self.foreign_count - self.free_count, ", ".join(f"{can_id:03X}" for can_id in self.foreign)
            raise ForeignMaster(
                f"another master started to send on {self.spec}: {number} frames, ids {ids}; no further writes sent",
                advice="end the other master, then start again",
            )

    def dispatch(self, frame: Frame) -> None:
        """Pass a frame to the handlers of its identifier."""
        can_id = frame.arbitration_id
        handlers = self._handlers.get(can_id)
        if handlers is None:
            self.counts["unclaimed"] += 1
            return
        outer, self._dispatching = self._dispatching, threading.get_ident()
        try:
            for handler in handlers:
                handler(can_id, frame.data, frame.timestamp)
        finally:
            self._dispatching = outer

    @property
    def in_handler(self) -> bool:
        """Return whether the calling thread runs a frame handler, in which waiting for a frame would block for ever."""
        return self._dispatching == threading.get_ident()

    def drain(self) -> int:
        """Dispatch the frames that have already arrived and return their number."""
        number = 0
        until_s = time.monotonic() + _DRAIN_S
        with self.receive_lock:
            while (frame := self.receive(0.0)) is not None:
                self.dispatch(frame)
                number += 1
                if time.monotonic() > until_s:
                    break
        return number

    def wait(self, arrived: threading.Event, deadline_s: float) -> bool:
        """Receive until `arrived` is set or the monotonic clock passes the deadline; chores are done meanwhile.

        Several threads may wait: one of them receives for all.
        """
        while not arrived.is_set():
            left = deadline_s - time.monotonic()
            if left <= 0:
                return False
            for chore in self._chores:
                chore()
            if self.receive_lock.acquire(blocking=False):
                try:
                    frame = None if arrived.is_set() else self.receive(min(left, 0.05))
                    if frame is not None:
                        self.dispatch(frame)
                finally:
                    self.receive_lock.release()
            else:
                arrived.wait(min(left, 0.002))
        return True

    def listen(self, duration_s: float) -> None:
        """Receive and dispatch frames for a given time."""
        self.wait(threading.Event(), time.monotonic() + duration_s)

    # -- handlers ----------------------------------------------------------------------------------------------------

    def subscribe(self, can_id: int, handler: Handler) -> None:
        """Call ``handler(can_id, data, time_s)`` for every frame with this id; it must only store."""
        self._handlers[can_id] = (*self._handlers.get(can_id, ()), handler)

    def unsubscribe(self, can_id: int, handler: Handler) -> None:
        """Undo `subscribe`; an unknown handler is ignored."""
        left = tuple(other for other in self._handlers.get(can_id, ()) if other != handler)
        if left:
            self._handlers[can_id] = left
        else:
            self._handlers.pop(can_id, None)

    def add_tap(self, tap: Tap) -> None:
        """Call `tap` for every frame received or sent."""
        self._taps = (*self._taps, tap)

    def remove_tap(self, tap: Tap) -> None:
        """Undo `add_tap`."""
        self._taps = tuple(other for other in self._taps if other != tap)

    def add_chore(self, chore: Callable[[], None]) -> None:
        """Call `chore` while waiting for answers, e.g. to keep the master's heartbeat going."""
        self._chores.append(chore)

    def remove_chore(self, chore: Callable[[], None]) -> None:
        """Undo `add_chore`."""
        if chore in self._chores:
            self._chores.remove(chore)

    def watch_master_id(self, can_id: int) -> None:
        """Treat frames with this id as frames of a master; all but the echo of own frames are counted in `foreign`."""
        if can_id not in self._sent:
            self._sent[can_id] = 0
            self.subscribe(can_id, self._on_master_frame)

    def _on_master_frame(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        if self.echoes and self._sent[can_id] > 0:
            self._sent[can_id] -= 1
        else:
            self.foreign[can_id] += 1
            self.foreign_count += 1

    # -- sending -----------------------------------------------------------------------------------------------------

    def prepare(self, can_id: int, size: int) -> Frame:
        """Return a reusable frame whose `data` (a bytearray) is filled before each transmission."""
        return can.Message(arbitration_id=can_id, data=bytearray(size), is_extended_id=False)

    def send_frame(self, frame: Frame) -> float:
        """Send a prepared frame; while the transmit queue is full, retry for a short time.

        Returns
        -------
        float
            By how much the attempt that succeeded began later than the first one, s.

        Raises
        ------
        BusError
            It could not be sent.
        """
        can_id = frame.arbitration_id
        sent = self._sent.get(can_id)
        if sent is not None and sent < _ECHO_MEMORY:
            self._sent[can_id] = sent + 1
        delay_s = 0.0
        with self._send_lock:
            try:
                self._adapter.send(frame)
            except BusError:
                raise
            except Exception as error:  # as in `receive`
                delay_s = self._send_again(frame, error)
        if self._taps and not self.echoes:
            self._hand_to_taps(frame, received=False)
        return delay_s

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame."""
        self.send_frame(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def _send_again(self, frame: Frame, error: Exception) -> float:
        began_s = time.monotonic()
        while time.monotonic() < began_s + SEND_TIMEOUT_S:
            self.counts["send_retries"] += 1
            time.sleep(0.0005)
            now_s = time.monotonic()
            try:
                self._adapter.send(frame)
            except Exception as again:
                error = again
            else:
                return now_s - began_s
        what = f"frame {frame.arbitration_id:03X} could not be sent within {SEND_TIMEOUT_S * 1e3:.0f} ms"
        raise DRIVE_RULES["queue_full"].raised(f"{self.spec}: {what}: {str(error) or type(error).__name__}") from error

    # -- life --------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the adapter; may be called again. Never raises: an adapter that is gone cannot be closed."""
        adapter, self._adapter = self._adapter, _CLOSED
        self._receive = _CLOSED.recv
        if adapter is not _CLOSED:
            try:
                adapter.shutdown()
            except Exception:
                self.counts["shutdown_failed"] += 1

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _refuse_closed(*_: object) -> NoReturn:
    raise BusError("the bus is closed", advice="open it again")


#: Adapter of a closed bus.
_CLOSED: Final = SimpleNamespace(recv=_refuse_closed, send=_refuse_closed)


def _no_kernel_can(error: BaseException | None) -> bool:
    """Return whether the root cause of an error is a kernel without CAN sockets (errno 97)."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            return True
        error = error.__cause__ or error.__context__
    return not hasattr(socket, "AF_CAN")


def open_bus(spec: BusSpec) -> Bus:
    """Open a bus.

    Parameters
    ----------
    spec : BusSpec
        What to open.

    Returns
    -------
    Bus
        To be used as a context manager, or closed.

    Raises
    ------
    BusError
        The interface is unknown, missing, down or refuses an option.
    """
    arguments = dict(spec.options)
    if spec.interface not in _WITHOUT_BITRATE:
        arguments["bitrate"] = spec.bitrate_bit_s
    if spec.interface == "udp_multicast":
        # without a hop frames stay on this computer: in one network two people with one example would share a bus
        arguments.setdefault("hop_limit", 0)
        arguments.setdefault("fd", False)
    try:
        adapter = can.Bus(interface=spec.interface, channel=spec.channel, **arguments)
    except Exception as error:
        # an interface whose driver is not installed fails where its library is first used
        missing = isinstance(error, NameError | AttributeError | ImportError)
        needs = _NEEDS.get(spec.interface, "check the name of the interface, its driver and its options")
        advice = _ADVICE.get(spec.interface, needs).format(channel=spec.channel, bitrate_bit_s=spec.bitrate_bit_s)
        if spec.interface == "socketcan" and _no_kernel_can(error):
            advice = _NO_KERNEL_CAN
        what = "its driver or package is not installed" if missing else " ".join(str(error).split())
        raise BusError(f"bus {spec} cannot be opened: {what}", advice=advice) from error
    return Bus(adapter, spec)
