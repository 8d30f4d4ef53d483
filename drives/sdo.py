"""SDO client that cannot mistake a stale answer for a fresh one (CiA 301, 7.2.4: expedited and segmented transfer).

One transfer at a time per node, under a lock. An answer counts only if its command specifier and, where it has them,
its index and subindex are those of the request. After a time-out the late answer may still come: the object is kept in
quarantine until it has, or until the slow time-out has passed, and is not asked again before. Reads may be repeated,
writes never.
"""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from typing import Final

from drives.abort import TIMED_OUT, TOGGLE_NOT_ALTERNATED, abort_error
from drives.bus import SDO_ANSWER_BASE, SDO_REQUEST_BASE, Bus
from drives.errors import DriveError, SdoProtocolError, SdoTimeout
from drives.latency import LatencyHistogram, SdoStatistics
from drives.objects import SIZE_BYTES, STRUCT_CODE

#: Longest object that is accepted, in bytes: a drive that sends without end does not fill the memory.
MAX_SIZE_BYTES: Final = 1 << 16
_HEAD: Final = struct.Struct("<BHB")
_CODE: Final = struct.Struct("<L")
_CCS_DOWNLOAD_SEGMENT, _CCS_DOWNLOAD, _CCS_UPLOAD, _CCS_UPLOAD_SEGMENT = 0x00, 0x20, 0x40, 0x60
_SCS_UPLOAD_SEGMENT, _SCS_DOWNLOAD_SEGMENT, _SCS_UPLOAD, _SCS_DOWNLOAD, _ABORT = 0x00, 0x20, 0x40, 0x60, 0x80
_TOGGLE: Final = 0x10
#: What `ask` asks for in turn, so that a late answer to one question is not taken for the answer to the next.
_QUESTIONS: Final = ((0x1000, 0), (0x1018, 1), (0x1001, 0), (0x1018, 2), (0x1018, 3), (0x1018, 4))


@dataclass(frozen=True, slots=True)
class Transfer:
    """How long to wait for an answer, and how often a read asks.

    Attributes
    ----------
    slow : bool
        Wait for the slow time-out of the node.
    attempts : int
        Requests of a read until it fails; a write is sent once.
    """

    slow: bool = False
    attempts: int = 2


NORMAL: Final = Transfer()
SLOW: Final = Transfer(slow=True)
ONCE: Final = Transfer(attempts=1)


@dataclass(slots=True)
class Posted:
    """A read that nobody waits for.

    Attributes
    ----------
    data_type : str
    until_s : float
        Monotonic time after which the answer no longer counts.
    value : int or None
        None = no answer yet, or a refusal.
    answered : bool
    """

    data_type: str
    until_s: float
    value: int | None = None
    answered: bool = False

    def take(self, answer: bytes) -> None:
        """Keep the value of an expedited answer; anything else counts as a refusal."""
        self.answered = True
        size = SIZE_BYTES[self.data_type]
        if answer[0] & 0xE0 == _SCS_UPLOAD and answer[0] & 0x02:
            self.value = int.from_bytes(answer[4 : 4 + size], "little", signed=self.data_type.startswith("i"))


@dataclass(frozen=True, slots=True)
class _Pending:
    """An answer that may still come: its specifier and address, and until when."""

    specifier: int
    address: tuple[int, int] | None
    until_s: float
    #: Number of the question of `ask`; 0 = a transfer that was given up.
    question: int = 0
    posted: Posted | None = None


class SdoClient:
    """SDO transfers with one node.

    Parameters
    ----------
    bus : Bus
        Where the node is.
    node_id : int
        1 to 127.
    timeout_s, slow_timeout_s : float
        Longest wait for an answer; for slow objects, and for what comes late after all.
    """

    def __init__(self, bus: Bus, node_id: int, timeout_s: float = 0.3, slow_timeout_s: float = 2.0) -> None:
        self.node_id = node_id
        self.timeout_s = timeout_s
        self.slow_timeout_s = slow_timeout_s
        self._bus = bus
        self._lock = threading.Lock()
        self._answers: deque[bytes] = deque(maxlen=64)
        self._arrived = threading.Event()
        self._waiting = False
        self._pending: list[_Pending] = []
        self._pending_lock = threading.Lock()
        self._strange = 0
        self._questions = 0
        self._counts: Counter[str] = Counter()
        self._latency = LatencyHistogram()
        bus.subscribe(SDO_ANSWER_BASE + node_id, self._on_answer)

    def close(self) -> None:
        """Stop listening."""
        self._bus.unsubscribe(SDO_ANSWER_BASE + self.node_id, self._on_answer)

    @property
    def statistics(self) -> SdoStatistics:
        """Latencies and what went wrong so far."""
        return SdoStatistics(
            node_id=self.node_id,
            count=self._latency.count,
            mean_s=self._latency.mean_s,
            max_s=self._latency.max_s,
            histogram=tuple(self._latency.bins),
            timeouts=self._counts["timeouts"],
            late=self._counts["late"],
            foreign=self._counts["foreign"],
            aborts=self._counts["aborts"],
        )

    # -- without waiting ---------------------------------------------------------------------------------------------

    def ask(self) -> None:
        """Ask for something that every device has, without waiting; `asked` until the answer comes, also a refusal."""
        address = _QUESTIONS[self._questions % len(_QUESTIONS)]
        self._questions += 1
        now = time.monotonic()
        question = _Pending(_SCS_UPLOAD, address, now + self.slow_timeout_s, self._questions)
        with self._pending_lock:
            self._pending = [*(pending for pending in self._pending if pending.until_s > now), question]
        self._bus.send(SDO_REQUEST_BASE + self.node_id, _HEAD.pack(_CCS_UPLOAD, *address) + bytes(4))

    def post(self, index: int, subindex: int, data_type: str) -> Posted:
        """Ask for an object without waiting; the answer is kept when it comes.

        Parameters
        ----------
        index, subindex : int
            Which object.
        data_type : str
            u8 i8 u16 i16 u32 i32.
        """
        now = time.monotonic()
        posted = Posted(data_type, now + self.timeout_s)
        address = (index, subindex)
        pending = _Pending(_SCS_UPLOAD, address, now + self.slow_timeout_s, posted=posted)
        with self._pending_lock:
            self._pending = [*(each for each in self._pending if each.until_s > now), pending]
        self._bus.send(SDO_REQUEST_BASE + self.node_id, _HEAD.pack(_CCS_UPLOAD, *address) + bytes(4))
        return posted

    @property
    def asked(self) -> bool:
        """Whether the last question of `ask` is still open."""
        return any(pending.question == self._questions for pending in self._pending)

    # -- values ------------------------------------------------------------------------------------------------------

    def read(self, index: int, subindex: int, data_type: str, options: Transfer = NORMAL) -> int:
        """Read an integer.

        Parameters
        ----------
        index, subindex : int
            Which object.
        data_type : str
            u8 i8 u16 i16 u32 i32.
        options : Transfer
            How long to wait and how often to ask.

        Raises
        ------
        SdoAbort, SdoTimeout, SdoProtocolError
            As `upload`; also when the answer does not fit the type.
        """
        data = self.upload(index, subindex, options)
        size = SIZE_BYTES[data_type]
        value = data[:size]
        signed = data_type.startswith("i")
        fill = b"\xff" if signed and value[-1:] > b"\x7f" else b"\0"
        if len(value) < size or data[size:].strip(fill):
            raise self._broken(f"{len(data)} bytes ({data[:8].hex(' ')}) are no {data_type}", (index, subindex), None)
        return int.from_bytes(value, "little", signed=signed)

    def write(self, index: int, subindex: int, data_type: str, value: int, options: Transfer = NORMAL) -> None:
        """Write an integer; it is sent once, whatever happens."""
        try:
            data = struct.pack("<" + STRUCT_CODE[data_type], value)
        except struct.error as error:
            raise self._broken(f"{value} is no {data_type}", (index, subindex), None) from error
        self.download(index, subindex, data, options)

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read a visible string."""
        return self.upload(index, subindex).rstrip(b"\0").decode("latin-1").strip()

    # -- transfers ---------------------------------------------------------------------------------------------------

    def upload(self, index: int, subindex: int = 0, options: Transfer = NORMAL) -> bytes:
        """Read an object.

        Raises
        ------
        SdoAbort
            The drive refused.
        SdoTimeout
            No answer, also not to the repeated requests.
        SdoProtocolError
            An answer that breaks the protocol.
        """
        with self._transfer():
            for _ in range(options.attempts - 1):
                with contextlib.suppress(SdoTimeout):
                    return self._upload(index, subindex, self._timeout_s(options))
            return self._upload(index, subindex, self._timeout_s(options))

    def download(self, index: int, subindex: int, data: bytes, options: Transfer = NORMAL) -> None:
        """Write an object; it is sent once.

        Raises
        ------
        SdoAbort, SdoTimeout, SdoProtocolError
            After a time-out it is unknown whether the drive has the value.
        """
        with self._transfer():
            self._download(index, subindex, data, self._timeout_s(options))

    def _timeout_s(self, options: Transfer) -> float:
        return self.slow_timeout_s if options.slow else self.timeout_s

    def _transfer(self) -> threading.Lock:
        if self._bus.in_handler:
            raise DriveError(
                "an SDO transfer was started from a frame handler",
                node=self.node_id,
                advice="only store the frame there",
            )
        return self._lock

    def _upload(self, index: int, subindex: int, timeout_s: float) -> bytes:
        address = (index, subindex)
        request = _HEAD.pack(_CCS_UPLOAD, index, subindex) + bytes(4)
        answer = self._request(request, _SCS_UPLOAD, address, address, timeout_s)
        command = answer[0]
        if command & 0x02:
            unused = (command >> 2) & 3 if command & 0x01 else 0
            return answer[4 : 8 - unused]
        size = _CODE.unpack_from(answer, 4)[0] if command & 0x01 else None
        if size is not None and size > MAX_SIZE_BYTES:
            raise self._broken(f"{size} bytes were announced", address, 0x05040005)
        return self._upload_segments(address, size, timeout_s)

    def _upload_segments(self, address: tuple[int, int], size: int | None, timeout_s: float) -> bytes:
        data = bytearray()
        toggle = 0
        while True:
            answer = self._request(
                bytes([_CCS_UPLOAD_SEGMENT | toggle, 0, 0, 0, 0, 0, 0, 0]),
                _SCS_UPLOAD_SEGMENT,
                None,
                address,
                timeout_s,
            )
            command = answer[0]
            if command & _TOGGLE != toggle:
                raise self._broken("wrong toggle bit in a segment", address, TOGGLE_NOT_ALTERNATED)
            data += answer[1 : 8 - ((command >> 1) & 7)]
            if len(data) > (MAX_SIZE_BYTES if size is None else size):
                raise self._broken(f"more than the {size} bytes announced", address, 0x06070012)
            if command & 0x01:
                break
            toggle ^= _TOGGLE
        if size is not None and len(data) != size:
            raise self._broken(f"{len(data)} bytes where {size} were announced", address, None)
        return bytes(data)

    def _download(self, index: int, subindex: int, data: bytes, timeout_s: float) -> None:
        address = (index, subindex)
        if 0 < len(data) <= 4:
            head = _HEAD.pack(_CCS_DOWNLOAD | (4 - len(data)) << 2 | 0x03, index, subindex)
            self._request(head + data.ljust(4, b"\0"), _SCS_DOWNLOAD, address, address, timeout_s)
            return
        head = _HEAD.pack(_CCS_DOWNLOAD | 0x01, index, subindex)
        self._request(head + _CODE.pack(len(data)), _SCS_DOWNLOAD, address, address, timeout_s)
        toggle = 0
        for start in range(0, max(len(data), 1), 7):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            command = _CCS_DOWNLOAD_SEGMENT | toggle | (7 - len(part)) << 1 | last
            answer = self._request(
                bytes([command]) + part.ljust(7, b"\0"), _SCS_DOWNLOAD_SEGMENT, None, address, timeout_s
            )
            if answer[0] & _TOGGLE != toggle:
                raise self._broken("wrong toggle bit in a segment", address, TOGGLE_NOT_ALTERNATED)
            toggle ^= _TOGGLE

    # -- one request, one answer -------------------------------------------------------------------------------------

    def _on_answer(self, can_id: int, data: bytes | bytearray, time_s: float) -> None:
        if self._waiting:
            self._answers.append(bytes(data))
            self._arrived.set()
        elif not self._settle_pending(bytes(data)):
            self._counts["foreign"] += 1

    def _request(
        self,
        request: bytes,
        specifier: int,
        echo: tuple[int, int] | None,
        address: tuple[int, int],
        timeout_s: float,
    ) -> bytes:
        """Send and return the answer that has this specifier and, unless None, echoes this address."""
        self._wait_out_quarantine(specifier, echo)
        self._bus.drain()
        self._answers.clear()
        self._strange = 0
        self._waiting = True
        start = time.monotonic()
        try:
            self._bus.send(SDO_REQUEST_BASE + self.node_id, request)
            while (answer := self._next_answer(start + timeout_s)) is not None:
                if self._is_mine(answer, specifier, echo, address):
                    self._latency.add(time.monotonic() - start)
                    return answer
        finally:
            self._waiting = False
        raise self._no_answer(specifier, echo, address, timeout_s)

    def _next_answer(self, deadline_s: float) -> bytes | None:
        while not self._answers:
            self._arrived.clear()
            if not self._answers and not self._bus.wait(self._arrived, deadline_s) and not self._answers:
                return None
        return self._answers.popleft()

    def _is_mine(self, answer: bytes, specifier: int, echo: tuple[int, int] | None, address: tuple[int, int]) -> bool:
        if len(answer) != 8:
            self._strange += 1
            return False
        command, index, subindex = _HEAD.unpack_from(answer)
        kind = command & 0xE0
        if kind == _ABORT and ((index, subindex) == address or (index, subindex) == (0, 0) and not self._pending):
            self._counts["aborts"] += 1
            raise abort_error(self.node_id, address, _CODE.unpack_from(answer, 4)[0])
        if kind == specifier and (echo is None or (index, subindex) == echo):
            return True
        if not self._settle_pending(answer):
            self._strange += 1
            self._counts["foreign"] += 1
        return False

    def _settle_pending(self, answer: bytes) -> bool:
        """Whether this is an answer that was given up: it leaves the quarantine."""
        if len(answer) != 8:
            return False
        command, index, subindex = _HEAD.unpack_from(answer)
        kind = command & 0xE0
        with self._pending_lock:
            for pending in self._pending:
                if kind in (pending.specifier, _ABORT) and pending.address in (None, (index, subindex)):
                    self._pending.remove(pending)
                    if pending.posted is not None:
                        pending.posted.take(answer)
                    else:
                        self._counts["late"] += not pending.question
                    return True
        return False

    def _wait_out_quarantine(self, specifier: int, echo: tuple[int, int] | None) -> None:
        """Wait until no answer that could be mistaken for the next one can come any more."""
        while True:
            now = time.monotonic()
            self._pending = [pending for pending in self._pending if pending.until_s > now]
            rivals = [
                pending
                for pending in self._pending
                if pending.specifier == specifier and pending.address in (None, echo)
            ]
            if not rivals:
                return
            settled = threading.Event()
            while rivals[0] in self._pending and (left := rivals[0].until_s - time.monotonic()) > 0:
                self._bus.wait(settled, time.monotonic() + min(left, 0.01))

    def _no_answer(
        self, specifier: int, echo: tuple[int, int] | None, address: tuple[int, int], timeout_s: float
    ) -> DriveError:
        self._counts["timeouts"] += 1
        now = time.monotonic()
        self._pending.append(_Pending(specifier, echo, now - timeout_s + max(self.slow_timeout_s, timeout_s)))
        self._send_abort(address, TIMED_OUT)
        index, subindex = address
        if self._strange:
            return SdoProtocolError(
                f"{self._strange} answers came, none of them to this request",
                node=self.node_id,
                index=index,
                subindex=subindex,
                advice="another SDO client talks to this node, or two nodes share its id: leave one",
            )
        return SdoTimeout(
            f"no SDO answer within {timeout_s * 1e3:.0f} ms",
            node=self.node_id,
            index=index,
            subindex=subindex,
            advice="check power, node id, bit rate and that the node is not in NMT state STOPPED",
        )

    def _broken(self, what: str, address: tuple[int, int], code: int | None) -> SdoProtocolError:
        if code is not None:
            self._send_abort(address, code)
        index, subindex = address
        return SdoProtocolError(
            what,
            node=self.node_id,
            index=index,
            subindex=subindex,
            code=code,
            advice="try again, then check the wiring",
        )

    def _send_abort(self, address: tuple[int, int], code: int) -> None:
        self._bus.send(SDO_REQUEST_BASE + self.node_id, _HEAD.pack(_ABORT, *address) + _CODE.pack(code))
