"""SDO client that rejects delayed responses to earlier requests (CiA 301, 7.2.4: expedited and segmented transfer).

One transfer at a time per node, under a lock. Reads may be repeated, writes never.
"""

from __future__ import annotations

import contextlib
import struct
import threading
from dataclasses import dataclass
from typing import Final

from drives.abort import TOGGLE_NOT_ALTERNATED
from drives.errors import DriveError, SdoTimeout
from drives.objects import SIZE_BYTES, STRUCT_CODE, decode_integer
from drives.printable import one_line
from drives.sdo_channel import (
    CCS_DOWNLOAD,
    CCS_DOWNLOAD_SEGMENT,
    CCS_UPLOAD,
    CCS_UPLOAD_SEGMENT,
    CODE,
    EXPEDITED,
    HEAD,
    SCS_DOWNLOAD,
    SCS_DOWNLOAD_SEGMENT,
    SCS_UPLOAD,
    SCS_UPLOAD_SEGMENT,
    SIZED,
    TOGGLE,
    Posted,
    SdoChannel,
    expedited_data,
)

__all__ = ["MAX_SIZE_BYTES", "NORMAL", "ONCE", "SLOW", "Posted", "SdoClient", "Transfer"]

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


class SdoClient(SdoChannel):
    """SDO transfers with one node; parameters as `SdoChannel`."""

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
