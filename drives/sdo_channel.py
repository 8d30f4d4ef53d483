"""One SDO channel to one node: a request, its answer, and delayed answers (CiA 301, 7.2.4.3).

An answer counts only if its command specifier and, where it has them, its index and subindex are those of the request.
After a time-out the answer may still arrive. The object is not requested again until it has arrived or the slow
time-out has passed.
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

from drives.abort import TIMED_OUT, abort_error
from drives.bus import SDO_ANSWER_BASE, SDO_REQUEST_BASE, Bus
from drives.errors import DriveError, SdoProtocolError, SdoTimeout
from drives.latency import LATENCY_EDGES_S, SdoStatistics
from drives.objects import SIZE_BYTES, decode_integer

HEAD: Final = struct.Struct("<BHB")
CODE: Final = struct.Struct("<L")
CCS_DOWNLOAD_SEGMENT, CCS_DOWNLOAD, CCS_UPLOAD, CCS_UPLOAD_SEGMENT = 0x00, 0x20, 0x40, 0x60
SCS_UPLOAD_SEGMENT, SCS_DOWNLOAD_SEGMENT, SCS_UPLOAD, SCS_DOWNLOAD, ABORT = 0x00, 0x20, 0x40, 0x60, 0x80
TOGGLE: Final = 0x10
EXPEDITED, SIZED = 0x02, 0x01
NOT_ANSWERING: Final = "check power, node id, bit rate and that the node is not in NMT state STOPPED"
#: Objects that `ask` requests in turn, so that a delayed answer is not taken for the answer to the next request.
_QUESTIONS: Final = ((0x1000, 0), (0x1018, 1), (0x1001, 0), (0x1018, 2), (0x1018, 3), (0x1018, 4))


def expedited_data(answer: bytes, size_bytes: int | None = None) -> bytes:
    """Data of an expedited upload answer of 8 bytes (CiA 301, 7.2.4.3.6).

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
        if answer[0] & 0xE0 == SCS_UPLOAD and answer[0] & EXPEDITED:
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
    #: Number of the question of `ask`; 0 = a transfer that was given up.
    question: int = 0
    posted: Posted | None = None
    requested_s: float = 0.0


class SdoChannel:
    """SDO channel to one node with one request at a time.

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

    # -- without waiting ---------------------------------------------------------------------------------------------

    def ask(self) -> None:
        """Request an object that every device has, without waiting; `asked` until an answer or refusal arrives."""
        address = _QUESTIONS[self._questions % len(_QUESTIONS)]
        self._questions += 1
        now = time.monotonic()
        question = Pending(SCS_UPLOAD, address, now + self.slow_timeout_s, self._questions, requested_s=now)
        with self._pending_lock:
            # an answer to an earlier question for this object says as well that the drive is there
            others = [each for each in self._pending if not (each.question and each.address == address)]
            self._pending = [*others, question]
        self._bus.send(SDO_REQUEST_BASE + self.node_id, HEAD.pack(CCS_UPLOAD, *address) + bytes(4))

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

    @property
    def asked(self) -> bool:
        """Return whether the last request of `ask` is still without a response."""
        return any(pending.question == self._questions for pending in self._pending)

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
        kind = command & 0xE0
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
                if command & 0xE0 in (each.specifier, ABORT) and each.address in (None, (index, subindex))
            ]
            if not fitting:
                return False
            self._pending.remove(fitting[0])
            posted = next((each.posted for each in reversed(fitting) if each.posted is not None), None)
            if posted is not None and not posted.answered:
                posted.take(answer)
            elif not fitting[0].question:
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
