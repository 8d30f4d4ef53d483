"""BLF for CANalyzer: the frames of the trace file stored beside a recording."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from drives.frame_log import SUFFIXES, read_frames, write_blf
from gateway.data.recording.reader import read
from gateway.errors import InputError


def blf_of(recording: Path) -> tuple[bytes, int]:
    """Content of a BLF file with the frames of a recording's trace, and how many they are.

    A recording holds words, not frames: the frames are those that `--trace` logged under the recording's name.

    Raises
    ------
    InputError
        The recording or its trace cannot be used, or there is none.
    """
    read(recording)
    traces = [path for suffix in SUFFIXES if (path := recording.with_suffix(suffix)).is_file()]
    if not traces:
        raise InputError(
            f"{recording}: no frame trace is beside it ({', '.join(recording.stem + suffix for suffix in SUFFIXES)});"
            f" a recording holds no frames: record with --trace {recording.with_suffix(SUFFIXES[0])}"
        )
    try:
        frames = read_frames(traces[0])
    except ValueError as error:
        raise InputError(f"{traces[0]}: cannot be read as a frame trace: {error}") from error
    except OSError as error:
        raise InputError(f"{traces[0]}: cannot be read: {error.strerror or error}") from error
    if not frames:
        raise InputError(f"{traces[0]}: holds no frame; record again with --trace {traces[0]}")
    with TemporaryDirectory(prefix="servo-gateway-") as folder:
        path = Path(folder) / "frames.blf"
        write_blf(path, frames)
        return path.read_bytes(), len(frames)
