"""Messages between motion loop and page process over a non-blocking socket.

A datagram is a row (`b"r"` and numbers) or a piece of a message (`b"p"`, the last one `b"P"`). The socket separates
datagrams and bounds the queue. If it is full, messages wait for the next SYNC and samples are dropped. The page process
returns one byte for each press of the stop button, and one for each heartbeat request.
"""

from __future__ import annotations

import pickle
import socket
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.events import PoseDone
from gateway.model.robot import Robot

Floats = NDArray[np.float64]

ROW: Final = b"r"
PIECE, LAST_PIECE = b"p", b"P"
#: Heartbeat: request of the motion loop, and answer of the page process.
ASK, ALIVE = b"h", b"H"
STOP: Final = b"S"
#: Largest piece of a message; well below what a socket holds.
PIECE_BYTES: Final = 32768
#: Largest datagram.
MOST_BYTES: Final = 65536
#: Numbers of a row before those of the arms: when it was sent (monotonic) [s], SYNC, time of the run [s], phase, and
#: SYNCs of this command not answered by some drive.
HEAD: Final = 5
#: Numbers per axis, as named by `gateway.motion.observer`; the position follows `target_rad`.
SHOWN: Final = ("q_rad", "target_rad", "joint_torque_nm", "modelled_torque_nm", "statusword")
PER_AXIS: Final = len(SHOWN)


@dataclass(frozen=True, slots=True)
class Hello:
    """First message: access to the page, and description of the command."""

    port: int
    token: str
    title: str
    stops: bool


@dataclass(frozen=True, slots=True, eq=False)
class ShownBody:
    """Convex body for display.

    Attributes
    ----------
    link : int
        Link, from 0, that it moves with; -1 = fixed.
    points_m : array of shape (v, 3)
        Its corners, in the frame of that link.
    faces : tuple of tuples of int
        Corners of each face, counter-clockwise seen from outside.
    """

    link: int
    points_m: Floats
    faces: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True, eq=False)
class ShownArm:
    """Constant data of an arm for the page.

    Attributes
    ----------
    name : str
    robot : Robot
    bodies : tuple of ShownBody
    boxes_m : array of shape (b, 2, 3)
        Lower and upper corners of what is kept out.
    assumed : tuple of str
        Bodies whose shape is not that of the robot's file, and why.
    modelled : bool
        Whether the links' masses are known; without them no torque of a model is shown.
    speed_rad_s, torque_nm, following_error_rad : arrays of shape (N,)
        Limits.
    """

    name: str
    robot: Robot
    bodies: tuple[ShownBody, ...]
    boxes_m: Floats
    assumed: tuple[str, ...]
    modelled: bool
    speed_rad_s: Floats
    torque_nm: Floats
    following_error_rad: Floats

    @property
    def axes(self) -> int:
        """Number of joints."""
        return self.robot.axes


@dataclass(frozen=True, slots=True, eq=False)
class ShownCell:
    """Cell whose drives are about to be enabled."""

    arms: tuple[ShownArm, ...]
    period_s: float


@dataclass(frozen=True, slots=True)
class Happened:
    """An event of the run."""

    event: object


@dataclass(frozen=True, slots=True)
class Heard:
    """An event on an observed bus: severity (`event_text`) and text."""

    grave: str
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class PoseSeen:
    """Both approach directions of a pose are measured; `modelled_nm` (N,) is the torque of the unloaded arm there."""

    done: PoseDone
    modelled_nm: Floats


@dataclass(frozen=True, slots=True)
class Ended:
    """The motion has ended; the reason is empty after normal completion.

    `disabled` is True where every drive was read as disabled.
    """

    reason: str
    disabled: bool = True


@dataclass(frozen=True, slots=True)
class CommandOver:
    """Last message: the command is ending."""

    reason: str


def pair_of_sockets() -> tuple[socket.socket, socket.socket]:
    """Return two non-blocking ends that separate datagrams and detect when the other one is closed."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return ends


def pieces(message: object) -> list[bytes]:
    """Return the datagrams of a message."""
    content = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    cuts = range(0, len(content), PIECE_BYTES)
    return [
        (LAST_PIECE if cut + PIECE_BYTES >= len(content) else PIECE) + content[cut : cut + PIECE_BYTES] for cut in cuts
    ]


class Unpacker:
    """Reassembles samples and messages from datagrams."""

    def __init__(self) -> None:
        self._content = bytearray()

    def take(self, datagram: bytes) -> Floats | Any | None:
        """Return a sample, a message, or None while a message is incomplete."""
        kind, content = datagram[:1], datagram[1:]
        if kind == ROW:
            return np.frombuffer(content)
        self._content += content
        if kind == PIECE:
            return None
        complete, self._content = bytes(self._content), bytearray()
        return pickle.loads(complete)
