"""Opening of a CAN adapter from its configuration, and the only receive path of the master.

Besides `frame_log` the only file that imports python-can. The thread that waits for an answer receives, and every frame
goes through one table of handlers, so that no frame waits in a cache. Frames of this master that the adapter echoes
(udp_multicast) are distinguished from frames of another master.
"""

from __future__ import annotations

import errno
import math
import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
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
NEEDS: Final = {
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
#: The adapter counts as broken when receiving has failed for so long [s], and so often, with nothing received between;
#: single failures are stray datagrams or errors of the wire.
_BROKEN_S: Final = 0.5
_BROKEN_FAILURES: Final = 20
#: Pause after a failed reception that was not the first one in a row [s].
_FAILED_PAUSE_S: Final = 0.001
#: Bit in the id of an error frame of SocketCAN (linux/can/error.h).
_CAN_ERROR_BUS_OFF: Final = 0x40
#: Interfaces over a vendor's library: an id of an error frame is not SocketCAN's, and they wait whole milliseconds and
#: spin for the rest, which is waited for here, in steps of `_STEP_S`.
_VENDOR: Final = frozenset({"pcan", "kvaser", "vector", "ixxat"})
_STEP_S: Final = 0.0002
#: How python-can 4.6 reports a controller that is bus-off, besides error frames of SocketCAN: by text and by state.
#: kvaser, vector and slcan do not report it; there the transmit queue gets full. The state is read at most every
#: `_STATE_S`; neither reading waits for the adapter.
_BUS_OFF_TEXT: Final = re.compile(r"bus[ -]?off", re.IGNORECASE)
_PCAN_BUS_OFF: Final = 0x10
_IS_BUS_OFF: Final[dict[str, Callable[[Any], bool]]] = {
    "pcan": lambda adapter: bool(adapter.status() & _PCAN_BUS_OFF),
    "ixxat": lambda adapter: adapter.state is can.BusState.ERROR,
}
_STATE_S: Final = 0.16
#: Codes of an adapter that is gone: errno of the socket (reported once, then the socket is mute) and of the serial
#: port, canstat.h, vxlapi.h; pcan and ixxat give only a text. What else means gone fails again and again.
_NO_DEVICE: Final = frozenset({errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.EBADF, errno.EIO})
_GONE_CODES: Final = {
    "socketcan": _NO_DEVICE,
    "slcan": _NO_DEVICE,
    "kvaser": frozenset({-3, -10, -15, -24, -26}),
    "vector": frozenset({118, 120, 129, 210, 211}),
}
_GONE_TEXT: Final = re.compile(r"handle .*is invalid|not initialized|device disconnected", re.IGNORECASE | re.DOTALL)
_GONE_ADVICE: Final = (
    "check the adapter and the cable, then start again; the drives stop by themselves when the master's heartbeat stops"
)
#: slcan returns at once on an acknowledgement, with frames behind it, unless it has time left: its shortest wait [s].
_SHORTEST_WAIT_S: Final = {"slcan": 0.0005}
#: What python-can's defaults do not suit: a read of slcan that waits 1 ms even for nothing, queues of 16 frames.
_DEFAULTS: Final[dict[str, dict[str, Any]]] = {
    # without a hop frames stay on this computer: in one network two people with one example would share a bus
    "udp_multicast": {"hop_limit": 0, "fd": False},
    "slcan": {"timeout": _STEP_S},
    "ixxat": {"rx_fifo_size": 1024, "tx_fifo_size": 128},
}
#: Own frames of one id that may be echoed at the same time: NMT commands to every node of a bus.
_ECHO_MEMORY: Final = 128
#: Odd frames that are taken in at once when there is no time left to wait.
_ODD_AT_ONCE: Final = 64
#: Longest time for reading frames that have already arrived [s].
_DRAIN_S: Final = 0.05
#: Interfaces whose frames carry this computer's wall clock, taken when a frame came in (on virtual: was sent).
#: Stamps of pcan, kvaser, vector and ixxat follow the adapter's clock, and drift; slcan stamps a frame when it is read.
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
        own = (spec.options.get(option, False) for option in ("receive_own_messages", "single_handle"))
        self.echoes = spec.interface in _ECHOING or any(own)
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
        #: Receptions that failed since something was received, and when the first of them did.
        self._failures, self._failing_s = 0, 0.0
        self._is_bus_off = _IS_BUS_OFF.get(spec.interface)
        self._state_s = -math.inf
        self._dispatching: int | None = None
        self._taps: tuple[Tap, ...] = ()
        self._recv: Callable[[float], Any] = adapter.recv
        self._shortest_wait_s = _SHORTEST_WAIT_S.get(spec.interface, 0.0)
        self._is_vendor = spec.interface in _VENDOR
        self._receive = self._receive_whole_ms if self._is_vendor else self._recv
        # a serial port without a time-out would block the cycle; other backends would wait until the frame is sent
        self._send_options = {"timeout": SEND_TIMEOUT_S} if spec.interface == "slcan" else {}
        for can_id in (NMT_ID, SYNC_ID, *range(SDO_REQUEST_BASE + 1, SDO_REQUEST_BASE + 128)):
            self.watch_master_id(can_id)

    # -- receiving ---------------------------------------------------------------------------------------------------

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next data frame with an 11 bit id, or None after the time-out; other frames are only counted.

        The time is a deadline: neither odd frames nor failures of the adapter extend it.

        Raises
        ------
        BusError
            The adapter is gone, bus-off (`BusOff`), or fails again and again.
        """
        deadline_s = time.monotonic() + timeout_s
        odd = 0
        while True:
            try:
                frame = self._receive(max(timeout_s, self._shortest_wait_s))
            except BusError:
                raise
            except Exception as error:  # python-can's backends raise what their libraries raise
                self._on_receive_failure(error, deadline_s)
            else:
                if frame is None:
                    if timeout_s > 0.0:  # without a wait ixxat hides errors
                        self._failures = 0
                    self._read_state()
                    return None
                self._failures = 0
                if self._taps:
                    self._hand_to_taps(frame, received=True)
                if not (frame.is_error_frame or frame.is_remote_frame or frame.is_extended_id):
                    return frame
                kind = "error" if frame.is_error_frame else "remote" if frame.is_remote_frame else "extended"
                self.counts[kind] += 1
                if kind == "error" and frame.arbitration_id & _CAN_ERROR_BUS_OFF and not self._is_vendor:
                    self.bus_off = True
            odd += 1
            timeout_s = deadline_s - time.monotonic()
            if timeout_s <= 0.0:
                if odd >= _ODD_AT_ONCE or self._failures > _BROKEN_FAILURES:
                    return None
                timeout_s = 0.0

    def _receive_whole_ms(self, timeout_s: float) -> Any:
        """Receive from a backend that rounds the time-out down to whole milliseconds."""
        until_s = time.monotonic() + timeout_s
        frame = self._recv(math.floor(timeout_s * 1e3) / 1e3)
        while frame is None and (left_s := until_s - time.monotonic()) > 0.0:
            time.sleep(min(left_s, _STEP_S))
            frame = self._recv(0.0)
        return frame

    def _on_receive_failure(self, error: Exception, deadline_s: float) -> None:
        self.counts["malformed"] += 1
        self._raise_if_gone(error)
        now_s = time.monotonic()
        if not self._failures:
            self._failing_s = now_s
        self._failures += 1
        if now_s - self._failing_s > _BROKEN_S and self._failures > _BROKEN_FAILURES:
            what = f"{self.spec}: receiving failed for {_BROKEN_S} s: {str(error) or type(error).__name__}"
            raise BusError(what, advice=_GONE_ADVICE) from error
        if self._failures > 1:
            time.sleep(max(0.0, min(_FAILED_PAUSE_S, deadline_s - now_s)))

    def _raise_if_gone(self, error: Exception) -> None:
        """Raise `BusError` when the failure shows that the adapter is gone, `BusOff` when its controller is bus-off."""
        causes = [error]
        while isinstance(cause := causes[-1].__cause__, Exception):
            causes.append(cause)
        codes = {getattr(each, name, None) for each in causes for name in ("error_code", "errno")}
        text = "; ".join(str(each) for each in causes)
        self._state_s = -math.inf
        self._read_state()
        if self.bus_off or _BUS_OFF_TEXT.search(text):
            self.bus_off = True
            what = f"{self.spec}: the CAN controller is bus-off: {error}"
            raise DRIVE_RULES["bus_off"].raised(what, more=_GONE_ADVICE) from error
        if codes & _GONE_CODES.get(self.spec.interface, frozenset()) or _GONE_TEXT.search(text):
            raise BusError(f"{self.spec}: the adapter is gone: {text}", advice=_GONE_ADVICE) from error

    def _read_state(self) -> None:
        """Read from time to time whether the controller is bus-off, where the adapter reports its state."""
        if self._is_bus_off is not None and (now_s := time.monotonic()) >= self._state_s + _STATE_S:
            self._state_s = now_s
            with suppress(Exception):  # an adapter that is gone: its next reception fails
                self.bus_off |= self._is_bus_off(self._adapter)

    def _hand_to_taps(self, frame: Any, *, received: bool) -> None:
        """Pass a frame to every tap; a tap that raises is counted and removed."""
        for tap in self._taps:
            try:
                tap(frame, received)
            except Exception:
                self.counts["taps_failed"] += 1
                self.remove_tap(tap)

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

    def prepare(self, can_id: int, size: int, *, is_remote: bool = False) -> Frame:
        """Return a reusable frame, whose `data` (a bytearray) is filled before each transmission, or a remote frame."""
        data = None if is_remote else bytearray(size)
        return can.Message(arbitration_id=can_id, data=data, dlc=size, is_remote_frame=is_remote, is_extended_id=False)

    def send_frame(self, frame: Frame) -> float:
        """Send a prepared frame; while the transmit queue is full, retry for a short time.

        Returns
        -------
        float
            By how much the attempt that succeeded began later than the first one, s.

        Raises
        ------
        BusError
            It could not be sent; `BusOff` where the controller is bus-off.
        """
        can_id = frame.arbitration_id
        sent = self._sent.get(can_id)
        if sent is not None and sent < _ECHO_MEMORY:
            self._sent[can_id] = sent + 1
        with self._send_lock:
            began_s = now_s = time.monotonic()
            while True:
                try:
                    self._adapter.send(frame, **self._send_options)
                    break
                except BusError:
                    raise
                except Exception as error:  # as in `receive`
                    self._raise_if_gone(error)
                    if now_s >= began_s + SEND_TIMEOUT_S:
                        self._raise_unsent(can_id, error)
                    self.counts["send_retries"] += 1
                    time.sleep(0.0005)
                    now_s = time.monotonic()
        if self._taps and not self.echoes:
            self._hand_to_taps(frame, received=False)
        return now_s - began_s

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame."""
        self.send_frame(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def _raise_unsent(self, can_id: int, error: Exception) -> NoReturn:
        """Raise `BusOff` where an error frame that was not read yet explains the failure, else `BusError`."""
        if not self.in_handler and self.receive_lock.acquire(blocking=False):
            try:
                self.drain()
            finally:
                self.receive_lock.release()
            self._raise_if_gone(error)
        what = f"{self.spec}: frame {can_id:03X} could not be sent within {SEND_TIMEOUT_S * 1e3:.0f} ms"
        what = f"{what}: {str(error) or type(error).__name__}"
        raise DRIVE_RULES["queue_full"].raised(what, more=_GONE_ADVICE) from error

    # -- life --------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the adapter; may be called again. Never raises: an adapter that is gone cannot be closed."""
        adapter, self._adapter = self._adapter, _CLOSED
        self._receive = self._recv = _CLOSED.recv
        self._is_bus_off = None
        if adapter is not _CLOSED:
            try:
                adapter.shutdown()
            except Exception:
                self.counts["shutdown_failed"] += 1

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _refuse_closed(*_: object, **_named: object) -> NoReturn:
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
    arguments = _DEFAULTS.get(spec.interface, {}) | dict(spec.options)
    if spec.interface not in _WITHOUT_BITRATE:
        arguments["bitrate"] = spec.bitrate_bit_s
    try:
        adapter = can.Bus(interface=spec.interface, channel=spec.channel, **arguments)
    except Exception as error:
        # an interface whose driver is not installed fails where its library is first used
        missing = isinstance(error, NameError | AttributeError | ImportError)
        needs = NEEDS.get(spec.interface, "check the name of the interface, its driver and its options")
        advice = _ADVICE.get(spec.interface, needs).format(channel=spec.channel, bitrate_bit_s=spec.bitrate_bit_s)
        if spec.interface == "socketcan" and _no_kernel_can(error):
            advice = _NO_KERNEL_CAN
        what = "its driver or package is not installed" if missing else " ".join(str(error).split())
        raise BusError(f"bus {spec} cannot be opened: {what}", advice=advice) from error
    return Bus(adapter, spec)
