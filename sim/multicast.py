"""python-can's udp_multicast bus for a sender that ignores its own frames.

Multicast loops every frame back to its sender. Six drives would decode twice as many of their own frames as of the
master's, so frames that were just sent are dropped by their bytes, before they are decoded. The socket and the frame
format are python-can's.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import time
from collections import Counter
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

MAX_FRAME_BYTES = 4096
#: SO_TIMESTAMPNS of Linux, which python-can switches on: when the kernel received a datagram.
SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@ll")
#: Own frames that never came back (the socket's buffer was full) are forgotten beyond this number.
MAX_OUTSTANDING = 4096


class QuietMulticastBus:
    """Multicast CAN bus for a server of simulated drives, with `send`, `recv` and `shutdown` only.

    Parameters
    ----------
    channel : multicast group
    options : of python-can's udp_multicast interface (port, hop_limit, ...)
    """

    def __init__(self, channel: str, **options: Any) -> None:
        self._bus = UdpMulticastBus(channel=channel, **options)
        self._address = (channel, int(options.get("port", 43113)))
        self._socket = socket.socket(fileno=os.dup(self._bus.fileno()))
        self._socket.setblocking(False)
        self._outstanding: Counter[bytes] = Counter()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus.

        Raises
        ------
        can.CanOperationError : the socket refuses it
        """
        data = pack_message(msg)
        if len(self._outstanding) > MAX_OUTSTANDING:
            self._outstanding.clear()
        self._outstanding[data] += 1
        try:
            self._socket.sendto(data, self._address)
        except BlockingIOError:
            select.select([], [self._socket], [], timeout)
            self._socket.sendto(data, self._address)
        except OSError as error:
            raise can.CanOperationError(f"udp_multicast: {error}") from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame of another sender, None after the timeout [s].

        Raises
        ------
        can.CanOperationError : the socket fails
        """
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                data, notes, _, _ = self._socket.recvmsg(MAX_FRAME_BYTES, socket.CMSG_SPACE(_STAMP.size))
            except BlockingIOError:
                wait = None if end is None else end - time.monotonic()
                if wait is not None and wait <= 0:
                    return None
                select.select([self._socket], [], [], wait)
                continue
            except OSError as error:
                raise can.CanOperationError(f"udp_multicast: {error}") from error
            if data in self._outstanding:
                self._outstanding[data] -= 1
                if not self._outstanding[data]:
                    del self._outstanding[data]
                continue
            message = _decoded(data)
            if message is not None:
                message.timestamp = _received_s(notes)
                return message

    def fileno(self) -> int:
        """Return the socket's file descriptor, for `select` over several buses."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Close the bus."""
        self._socket.close()
        self._bus.shutdown()


def _received_s(notes: list[tuple[int, int, bytes]]) -> float:
    """When the kernel received a datagram, wall clock [s]; 0 where it is not available."""
    for level, kind, data in notes:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) >= _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack_from(data)
            return seconds + nanoseconds * 1e-9
    return 0.0


def _decoded(data: bytes) -> can.Message | None:
    """Return the CAN frame of a datagram, or None if it holds none (any computer can send to a multicast group)."""
    try:
        return unpack_message(data)
    except Exception:
        return None
