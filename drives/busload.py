"""Bus load of classic CAN with 11 bit identifiers from frame lengths (ISO 11898-1, with interframe space)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

#: Largest planned worst-case load of a bus in real time [%].
LOAD_LIMIT_PERCENT: Final = 70.0


def frame_bits(size_bytes: int) -> int:
    """Return the bits of a data frame of n bytes without stuff bits: 47 + 8 n."""
    return 47 + 8 * size_bytes


def frame_bits_worst(size_bytes: int) -> int:
    """Return the bits of a data frame with the most stuff bits: one per four of 34 + 8 n bits."""
    return frame_bits(size_bytes) + (34 + 8 * size_bytes - 1) // 4


def cycle_bits_worst(sizes_bytes: Iterable[int]) -> int:
    """Return the worst-case bits of one SYNC cycle.

    Parameters
    ----------
    sizes_bytes : iterable of int
        Length of every frame of the cycle, the SYNC (0) included.
    """
    return sum(frame_bits_worst(size) for size in sizes_bytes)


def load_percent(bits: float, duration_s: float, bitrate_bit_s: float) -> float:
    """Return the bus load of `bits` sent in `duration_s` [%]."""
    return 100.0 * bits / (duration_s * bitrate_bit_s)
