"""Start of a Python module as a child process, pipes to it that never block, and messages that pass through them."""

from __future__ import annotations

import os
import pickle
import signal
import struct
import subprocess
import sys
from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import Any, Final

#: Largest piece that is read or written at once.
PIECE_BYTES: Final = 65536
#: What is said of a child that has ended before its work was done.
ENDED: Final = "the process that writes it ended early"
ADVICE: Final = "check the system log for lack of memory"
#: Size that is requested of a pipe, whose content outlives this program: seconds of samples and frames, while the
#: child is busy.
_PIPE_BYTES: Final = 1 << 20
#: File, number of the message, length of its content.
_HEAD: Final = struct.Struct("<IIQ")


def framed(file: int, number: int, content: object) -> bytes:
    """Return a message or an answer as sent through a pipe."""
    data = pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
    return _HEAD.pack(file, number, len(data)) + data


def complete_messages(received: bytearray) -> Iterator[tuple[int, int, bytes]]:
    """Remove the complete messages from received bytes; yield file, number and pickled content of each."""
    while len(received) >= _HEAD.size:
        file, number, length = _HEAD.unpack_from(received)
        end = _HEAD.size + length
        if len(received) < end:
            return
        content = bytes(received[_HEAD.size : end])
        del received[:end]
        yield file, number, content


def start_module(
    program: str, signals: Collection[signal.Signals], descriptors: Collection[int] = ()
) -> subprocess.Popen[bytes]:
    """Run a module in its own session, so that Ctrl-C in a terminal does not reach it.

    Parameters
    ----------
    program : str
    signals : collection of Signals
        Blocked in the child: a terminal or a service manager sends these to all processes, and the child ends when its
        work is done.
    descriptors : collection of int
        Handed over in place of pipes to its standard input and output; their numbers are its arguments.

    Returns
    -------
    Popen
        Its standard input and output are unbuffered. Where they would block, writing and reading return None.
    """
    stream = subprocess.DEVNULL if descriptors else subprocess.PIPE
    # The same modules are found there as here, wherever this process was started.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    # the child inherits the mask; what comes meanwhile is delivered here afterwards
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", program, *map(str, descriptors)],
            stdin=stream,
            stdout=stream,
            stderr=subprocess.DEVNULL,
            env=environment,
            pass_fds=tuple(descriptors),
            start_new_session=True,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    if not descriptors:
        process.stdin, process.stdout = _own_end(process.stdin, "wb"), _own_end(process.stdout, "rb")
    return process


def _own_end(pipe: Any, mode: str) -> Any:
    """Return a non-blocking pipe end with a descriptor above 2, so that it cannot replace a closed standard stream."""
    import fcntl  # pipes of this kind are of Linux and macOS; what only reads needs none

    with pipe:
        descriptor = fcntl.fcntl(pipe.fileno(), fcntl.F_DUPFD_CLOEXEC, 3)
    os.set_blocking(descriptor, False)
    with suppress(OSError, AttributeError):  # not on macOS, and not beyond what one user may have
        fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    return open(descriptor, mode, buffering=0)
