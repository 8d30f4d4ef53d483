"""Process that writes the files of a moving command (`python -m gateway.data.recording.disk_process`).

Started by `gateway.data.disk.Disk`. Messages are read from standard input, and answered on standard output when they
are on disk. The first message of a file opens it. Each file has its own thread, so that a file whose write takes
seconds delays no other one, and the pipe is always read. At the end of the input all files are closed: the program
has ended or was killed.
"""

from __future__ import annotations

import errno
import os
import pickle
import select
import threading
from contextlib import suppress
from queue import SimpleQueue

from drives.child_process import PIECE_BYTES, complete_messages, framed
from drives.realtime import leave_real_time
from gateway.errors import InputError

#: Between two checks whether the program is still there: another process may hold its end of the pipe [s].
CHECK_S = 0.5
#: Number and pickled content of a message; None at the end of the input.
Waiting = SimpleQueue[tuple[int, bytes] | None]
#: Answers are sent by all threads.
_ANSWERING = threading.Lock()


def main() -> None:
    """Pass messages to the threads of their files until the input ends."""
    leave_real_time()
    parent, received = os.getppid(), bytearray()
    files: dict[int, Waiting] = {}
    threads: list[threading.Thread] = []
    while True:
        if select.select([0], [], [], CHECK_S)[0]:
            piece = os.read(0, PIECE_BYTES)
            if not piece:
                break
            received += piece
        elif os.getppid() != parent:
            break
        for file, number, content in complete_messages(received):
            if file not in files:
                files[file] = SimpleQueue()
                threads.append(threading.Thread(target=_write, args=(file, files[file])))
                threads[-1].start()
            files[file].put((number, content))
    for waiting in files.values():
        waiting.put(None)
    for thread in threads:  # not left to the end of the interpreter, in which modules cannot be loaded any more
        thread.join()


def _write(file: int, waiting: Waiting) -> None:
    """Open a file, execute its messages, and close it after its last one or at the end of the input."""
    number, failure = 0, None
    message = waiting.get()
    try:
        kind, *arguments = pickle.loads(message[1] if message else b"")
        with kind(*arguments) as writer:
            _answer(file, 0, None)
            while (message := waiting.get()) is not None:
                number, content = message
                try:
                    call = pickle.loads(content)
                    if call is None:
                        break
                    method, values = call
                    method(writer, *values)
                    failure = None
                except Exception as error:
                    failure = _failure_of(error)
                _answer(file, number, failure)
        failure = None
    except Exception as error:
        failure = _failure_of(error)
    while message is not None:  # it is closed, or could not be opened
        _answer(file, number, failure)
        message = waiting.get()
        number = message[0] if message else 0


def _failure_of(error: Exception) -> OSError:
    """Return an error as an answer."""
    if isinstance(error, OSError) and error.errno:
        return OSError(error.errno, error.strerror)
    return OSError(errno.EIO, str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}")


def _answer(file: int, number: int, failure: OSError | None) -> None:
    """Send an answer; ignore a closed pipe."""
    with _ANSWERING, suppress(BrokenPipeError):
        os.write(1, framed(file, number, failure))


if __name__ == "__main__":
    main()
