"""SDO client of one node: a request, its answer, and delayed answers (CiA 301, 7.2.4: expedited, segmented transfer).

One transfer at a time, under a lock. Reads may be repeated, writes never. An answer counts only if its command
specifier and, where it has them, its index and subindex are those of the request. After a time-out the answer may still
arrive. The object is not requested again until it has arrived or the slow time-out has passed.
"""

from __future__ import annotations

import contextlib
import math
import struct
import threading
import time
from bisect import bisect_left
from collections import Counter, deque
from dataclasses import dataclass
from typing import Final

from drives.abort import TIMED_OUT, TOGGLE_NOT_ALTERNATED, abort_error
from drives.bus import SDO_ANSWER_BASE, SDO_REQUEST_BASE, Bus
from drives.errors import DriveError, SdoProtocolError, SdoTimeout
from drives.objects import SIZE_BYTES, STRUCT_CODE, decode_integer
from drives.printable import one_line

HEAD: Final = struct.Struct("<BHB")
CODE: Final = struct.Struct("<L")
CCS_DOWNLOAD_SEGMENT, CCS_DOWNLOAD, CCS_UPLOAD, CCS_UPLOAD_SEGMENT = 0x00, 0x20, 0x40, 0x60
SCS_UPLOAD_SEGMENT, SCS_DOWNLOAD_SEGMENT, SCS_UPLOAD, SCS_DOWNLOAD, ABORT = 0x00, 0x20, 0x40, 0x60, 0x80
TOGGLE: Final = 0x10
EXPEDITED, SIZED = 0x02, 0x01
#: Bits of the command specifier in the first byte.
COMMAND_BITS: Final = 0xE0
NOT_ANSWERING: Final = "check power, node id, bit rate and that the node is not in NMT state STOPPED"
#: Objects that `ask` requests in turn, so that a delayed answer is not taken for the answer to the next request.
_QUESTIONS: Final = ((0x1000, 0), (0x1018, 1), (0x1001, 0), (0x1018, 2), (0x1018, 3), (0x1018, 4))
#: Longest object that is accepted, in bytes: a drive that sends without end does not fill the memory.
MAX_SIZE_BYTES: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Transfer:
    """Timeout and number of attempts of a transfer.

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


def expedited_data(answer: bytes, size_bytes: int | None = None) -> bytes:
    """Return the data of an expedited upload answer or download request of 8 bytes (CiA 301, 7.2.4.3.3, 7.2.4.3.6).

    Parameters
    ----------
    answer : bytes
    size_bytes : int, optional
        Size of the object. An answer that indicates no size has undefined bytes behind it, and is cut there.
    """
    command = answer[0]
    if not command & SIZED:
        return answer[4 : 8 if size_bytes is None else 4 + size_bytes]
    return answer[4 : 8 - (command >> 2 & 3)]


@dataclass(slots=True)
class Posted:
    """SDO read request that does not block, and its result.

    Attributes
    ----------
    data_type : str
    until_s : float
        Monotonic time after which the answer no longer counts.
    value : int or None
        None = no answer yet, or a refusal.
    answered : bool
    requested_s : float
        Monotonic time: the drive has read the value since then. Where an answer to an earlier question may have been
        lost, that is when the earlier question was asked. Infinite = not known.
    """

    data_type: str
    until_s: float
    value: int | None = None
    answered: bool = False
    requested_s: float = math.inf

    def take(self, answer: bytes) -> None:
        """Keep the value of an expedited answer; anything else counts as a refusal."""
        self.answered = True
        if answer[0] & COMMAND_BITS == SCS_UPLOAD and answer[0] & EXPEDITED:
            size = SIZE_BYTES[self.data_type]
            with contextlib.suppress(ValueError):
                data = expedited_data(answer, size)
                self.value = decode_integer(data, size, signed=self.data_type.startswith("i"))


@dataclass(frozen=True, slots=True)
class Pending:
    """Response that may still arrive after its time-out: specifier, address, expiry time and request time."""

    specifier: int
    address: tuple[int, int] | None
    until_s: float
    posted: Posted | None = None
    requested_s: float = 0.0


#: Upper edges of the latency histogram, s; the last bin is open.
LATENCY_EDGES_S: Final = (0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True, slots=True)
class SdoStatistics:
    """Latency of the SDO responses of one node, and numbers of failed requests.

    Attributes
    ----------
    node_id : int
    count : int
        Answers in time.
    mean_s, max_s : float
        Of their latency.
    histogram : tuple of int
        Answers per bin; upper edges `LATENCY_EDGES_S`, the last bin is open.
    timeouts, late, foreign, aborts : int
        Requests without an answer; answers after their time-out; answers without a request; refusals.
    """

    node_id: int
    count: int
    mean_s: float
    max_s: float
    histogram: tuple[int, ...]
    timeouts: int
    late: int
    foreign: int
    aborts: int


class SdoClient:
    """SDO transfers with one node, one request at a time.

    Parameters
    ----------
    bus : Bus
        Where the node is.
    node_id : int
        1 to 127.
    timeout_s, slow_timeout_s : float
        Longest wait for an answer; for slow objects, and for delayed answers.
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
        self._pending: list[Pending] = []
        self._pending_lock = threading.Lock()
        self._strange = 0
        self._questions = 0
        self._counts: Counter[str] = Counter()
        self._latency_bins = [0] * (len(LATENCY_EDGES_S) + 1)
        self._latency_sum_s = self._latency_max_s = 0.0
        bus.subscribe(SDO_ANSWER_BASE + node_id, self._on_answer)

    def close(self) -> None:
        """Stop listening."""
        self._bus.unsubscribe(SDO_ANSWER_BASE + self.node_id, self._on_answer)

    @property
    def statistics(self) -> SdoStatistics:
        """Return the latencies and the numbers of failed requests so far."""
        count = sum(self._latency_bins)
        return SdoStatistics(
            node_id=self.node_id,
            count=count,
            mean_s=self._latency_sum_s / max(count, 1),
            max_s=self._latency_max_s,
            histogram=tuple(self._latency_bins),
            timeouts=self._counts["timeouts"],
            late=self._counts["late"],
            foreign=self._counts["foreign"],
            aborts=self._counts["aborts"],
        )

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
        size = SIZE_BYTES[data_type]
        data = self.upload(index, subindex, options, size)
        try:
            return decode_integer(data, size, signed=data_type.startswith("i"))
        except ValueError as error:
            raise self._broken(str(error), (index, subindex), None) from error

    def write(self, index: int, subindex: int, data_type: str, value: int, options: Transfer = NORMAL) -> None:
        """Write an integer; it is sent once, whatever happens."""
        try:
            data = struct.pack("<" + STRUCT_CODE[data_type], value)
        except struct.error as error:
            raise self._broken(f"{value} is no {data_type}", (index, subindex), None) from error
        self.download(index, subindex, data, options)

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read a visible string; non-printable characters become spaces."""
        return one_line(self.upload(index, subindex).rstrip(b"\0").decode("latin-1"))

    # -- transfers ---------------------------------------------------------------------------------------------------

    def upload(self, index: int, subindex: int = 0, options: Transfer = NORMAL, size_bytes: int | None = None) -> bytes:
        """Read an object.

        Parameters
        ----------
        index, subindex : int
            Which object.
        options : Transfer
            How long to wait and how often to ask.
        size_bytes : int, optional
            Its size. An answer that indicates none is cut to it, any other is returned as it is.

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
                    return self._upload(index, subindex, self._timeout_s(options), size_bytes)
            return self._upload(index, subindex, self._timeout_s(options), size_bytes)

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

    def _upload(self, index: int, subindex: int, timeout_s: float, size_bytes: int | None) -> bytes:
        address = (index, subindex)
        request = HEAD.pack(CCS_UPLOAD, index, subindex) + bytes(4)
        answer = self._request(request, SCS_UPLOAD, address, address, timeout_s)
        command = answer[0]
        if command & EXPEDITED:
            return expedited_data(answer, size_bytes)
        size = CODE.unpack_from(answer, 4)[0] if command & SIZED else None
        if size is not None and size > MAX_SIZE_BYTES:
            raise self._broken(f"{size} bytes were announced", address, 0x05040005)
        return self._upload_segments(address, size, timeout_s)

    def _upload_segments(self, address: tuple[int, int], size: int | None, timeout_s: float) -> bytes:
        data = bytearray()
        toggle = 0
        while True:
            answer = self._request(
                bytes([CCS_UPLOAD_SEGMENT | toggle, 0, 0, 0, 0, 0, 0, 0]),
                SCS_UPLOAD_SEGMENT,
                None,
                address,
                timeout_s,
            )
            command = answer[0]
            if command & TOGGLE != toggle:
                raise self._broken("wrong toggle bit in a segment", address, TOGGLE_NOT_ALTERNATED)
            data += answer[1 : 8 - ((command >> 1) & 7)]
            if len(data) > (MAX_SIZE_BYTES if size is None else size):
                raise self._broken(f"more than the {size} bytes announced", address, 0x06070012)
            if command & 0x01:
                break
            toggle ^= TOGGLE
        if size is not None and len(data) != size:
            raise self._broken(f"{len(data)} bytes where {size} were announced", address, None)
        return bytes(data)

    def _download(self, index: int, subindex: int, data: bytes, timeout_s: float) -> None:
        address = (index, subindex)
        if 0 < len(data) <= 4:
            head = HEAD.pack(CCS_DOWNLOAD | (4 - len(data)) << 2 | 0x03, index, subindex)
            self._request(head + data.ljust(4, b"\0"), SCS_DOWNLOAD, address, address, timeout_s)
            return
        head = HEAD.pack(CCS_DOWNLOAD | 0x01, index, subindex)
        self._request(head + CODE.pack(len(data)), SCS_DOWNLOAD, address, address, timeout_s)
        toggle = 0
        for start in range(0, max(len(data), 1), 7):
            part = data[start : start + 7]
            last = start + 7 >= len(data)
            command = CCS_DOWNLOAD_SEGMENT | toggle | (7 - len(part)) << 1 | last
            answer = self._request(
                bytes([command]) + part.ljust(7, b"\0"), SCS_DOWNLOAD_SEGMENT, None, address, timeout_s
            )
            if answer[0] & TOGGLE != toggle:
                raise self._broken("wrong toggle bit in a segment", address, TOGGLE_NOT_ALTERNATED)
            toggle ^= TOGGLE

    # -- without waiting ---------------------------------------------------------------------------------------------

    def ask(self) -> Posted:
        """Request an object that every device has, without waiting; its answer shows that the device is there."""
        address = _QUESTIONS[self._questions % len(_QUESTIONS)]
        self._questions += 1
        return self.post(*address, "u32")

    def post(self, index: int, subindex: int, data_type: str) -> Posted:
        """Ask for an object without waiting; the answer is kept when it comes.

        While a question for the object is open it is not asked again: that question is returned. The next answer for
        the object belongs to the last question, so that an answer that is lost shifts none of those that follow.

        Parameters
        ----------
        index, subindex : int
            Which object.
        data_type : str
            u8 i8 u16 i16 u32 i32.
        """
        now = time.monotonic()
        address = (index, subindex)
        with self._pending_lock:
            self._pending = [each for each in self._pending if each.until_s > now]
            before = [each for each in self._pending if each.specifier == SCS_UPLOAD and each.address == address]
            last = next((each.posted for each in reversed(before) if each.posted is not None), None)
            if last is not None and not last.answered and now < last.until_s:
                return last
            requested_s = min((each.requested_s for each in before), default=now)
            posted = Posted(data_type, now + self.timeout_s, requested_s=requested_s)
            until_s = now + self.slow_timeout_s
            self._pending.append(Pending(SCS_UPLOAD, address, until_s, posted=posted, requested_s=now))
        self._bus.send(SDO_REQUEST_BASE + self.node_id, HEAD.pack(CCS_UPLOAD, *address) + bytes(4))
        return posted

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
                    latency_s = time.monotonic() - start
                    self._latency_bins[bisect_left(LATENCY_EDGES_S, latency_s)] += 1
                    self._latency_sum_s += latency_s
                    self._latency_max_s = max(self._latency_max_s, latency_s)
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
        command, index, subindex = HEAD.unpack_from(answer)
        kind = command & COMMAND_BITS
        if kind == ABORT and ((index, subindex) == address or (index, subindex) == (0, 0) and not self._pending):
            self._counts["aborts"] += 1
            raise abort_error(self.node_id, address, CODE.unpack_from(answer, 4)[0])
        if kind == specifier and (echo is None or (index, subindex) == echo):
            return True
        if not self._settle_pending(answer):
            self._strange += 1
            self._counts["foreign"] += 1
        return False

    def _settle_pending(self, answer: bytes) -> bool:
        """Return whether a frame is the response to a timed-out request, which is then no longer expected."""
        if len(answer) != 8:
            return False
        command, index, subindex = HEAD.unpack_from(answer)
        with self._pending_lock:
            fitting = [
                each
                for each in self._pending
                if command & COMMAND_BITS in (each.specifier, ABORT) and each.address in (None, (index, subindex))
            ]
            if not fitting:
                return False
            self._pending.remove(fitting[0])
            posted = next((each.posted for each in reversed(fitting) if each.posted is not None), None)
            if posted is not None and not posted.answered:
                posted.take(answer)
            else:
                self._counts["late"] += 1
        return True

    def _wait_out_quarantine(self, specifier: int, echo: tuple[int, int] | None) -> None:
        """Wait until no delayed response can arrive that could be mistaken for the next one."""
        while True:
            now = time.monotonic()
            with self._pending_lock:
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
        requested_s = now - timeout_s
        until_s = requested_s + max(self.slow_timeout_s, timeout_s)
        with self._pending_lock:
            self._pending.append(Pending(specifier, echo, until_s, requested_s=requested_s))
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
            advice=NOT_ANSWERING,
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
        self._bus.send(SDO_REQUEST_BASE + self.node_id, HEAD.pack(ABORT, *address) + CODE.pack(code))
