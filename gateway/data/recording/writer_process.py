"""Process that writes a recording (`python -m gateway.data.recording.writer_process`), started by `VisitQueue`.

HDF5 holds Python's lock while a file is built, and a disk may take seconds to sync; neither may delay the motion
loop. Visits are read from standard input, completed writes are reported on standard output. At the end of the input
the process writes all complete visits and ends.
"""

from __future__ import annotations

from drives.realtime import leave_real_time
from gateway.data.piping import PipeEnd
from gateway.data.recording.lock import sole_writer
from gateway.data.recording.pipe import (
    Failed,
    Finish,
    Finished,
    Keep,
    Ready,
    Start,
    Written,
)
from gateway.data.recording.writer import RecordingWriter
from gateway.errors import InputError

#: How long the writer of a run that was killed may still be busy with what it was given.
PATIENCE_S = 20.0


def main() -> None:
    """Write visits until the input ends."""
    leave_real_time()
    feed = PipeEnd(0, 1)
    start = feed.receive()
    if not isinstance(start, Start):
        return
    try:
        with sole_writer(start.path, PATIENCE_S):
            _record(feed, start)
    except InputError as error:
        feed.say(Ready(str(error)))


def _record(feed: PipeEnd, start: Start) -> None:
    writer = RecordingWriter(start.path, start.header, start.earlier, start.write)
    try:
        writer.begin(start.arm)
        feed.say(Ready(""))
        _serve(feed, writer)
    finally:
        writer.close()


def _serve(feed: PipeEnd, writer: RecordingWriter) -> None:
    number = 0
    while (message := feed.receive()) is not None:
        reason = ""
        try:
            if isinstance(message, Keep):
                number = message.visit.number
                writer.store(message.arm, message.visit)
            elif isinstance(message, Finish):
                writer.finish(message.arm, message.status, message.reason, message.statistics)
        except InputError as error:
            reason = str(error)
        except Exception as error:
            reason = f"{writer.path}: cannot be written: {type(error).__name__}: {error}"
        feed.say(Failed(reason) if reason else Written(number))
        if isinstance(message, Finish):
            feed.say(Finished(message.question, reason))


if __name__ == "__main__":
    main()
