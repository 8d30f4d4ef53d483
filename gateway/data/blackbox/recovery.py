"""Recover a black box from parts on disk after the motion program and the storing process were both killed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from drives.file_lock import lock_file
from gateway.data.blackbox.ring_buffer import HEADER, box_of, folder_of, header_in, parts_in, remove

BOTH_KILLED: Final = "the program that moved the arm and its recorder process were killed: data until then"


def recover_box(recording: Path) -> None:
    """Write the black box from parts whose process has ended, and delete the parts; do nothing if there are none.

    Raises
    ------
    OSError
        It cannot be written; the parts stay.
    """
    folder = folder_of(recording)
    try:
        descriptor = os.open(folder / HEADER, os.O_RDWR)
    except FileNotFoundError:
        return
    try:
        lock_file(descriptor)
        header, parts = header_in(folder), parts_in(folder)
        if header is not None and parts:
            from gateway.data.blackbox.box import write_box  # HDF5 takes its time to load, and is seldom needed

            write_box(box_of(recording), header, parts, BOTH_KILLED)
        remove(folder)
    except BlockingIOError:
        return  # the run goes on, or its box is being written
    finally:
        os.close(descriptor)
