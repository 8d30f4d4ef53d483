"""Process that stores the last seconds on disk (`python -m gateway.data.blackbox.recorder_process`).

Started by `BoxRecorder`. Parts are read from standard input and stored at once. If the run fails, or the sending
process ends without a final message, the parts become the black box; after a normal end they are deleted.
"""

from __future__ import annotations

from drives.realtime import leave_real_time
from gateway.data.blackbox.messages import BoxEnd, BoxReady, BoxVerdict
from gateway.data.blackbox.part import BoxHeader, unpack
from gateway.data.blackbox.recovery import recover_box
from gateway.data.blackbox.ring_buffer import Ring, box_of, folder_of, parts_in, remove
from gateway.data.piping import PipeEnd

KILLED = "the program that moved the arm was killed or ended without a final message: data until then"


def main() -> None:
    """Store parts until standard input is closed."""
    leave_real_time()
    feed = PipeEnd(0, 1)
    header = feed.receive()
    if not isinstance(header, BoxHeader):
        return
    folder, failed, reason = folder_of(header.recording), "", KILLED
    try:
        recover_box(header.recording)
        ring, has_verdict = Ring(folder, header), False
        feed.say(BoxReady())
        while (message := feed.receive()) is not None:
            if isinstance(message, BoxVerdict):
                reason, has_verdict = message.reason, True
                break
            part = unpack(message)
            if part is not None:
                ring.add(message, part.time_s, part.wall_s)
        parts = parts_in(folder)
        if reason is not None and (has_verdict or parts):
            from gateway.data.blackbox.box import write_box  # HDF5 takes its time to load, and is seldom needed

            write_box(box_of(header.recording), header, parts, reason)
        remove(folder)
        ring.close()
    except OSError as error:
        failed = f"{box_of(header.recording)}: cannot be written: {error.strerror or error}"
    feed.say(BoxEnd(failed))


if __name__ == "__main__":
    main()
