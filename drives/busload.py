"""Load of a classic CAN bus with 11 bit identifiers, from frame lengths (ISO 11898-1, interframe space included)."""

from __future__ import annotations

from collections.abc import Iterable


def frame_bits(size_bytes: int) -> int:
    """Bits of a data frame without stuff bits: 47 + 8 n."""
    return 47 + 8 * size_bytes


def frame_bits_worst(size_bytes: int) -> int:
    """Bits of a data frame with the most stuff bits possible: one after every four of the 34 + 8 n bits stuffed."""
    return frame_bits(size_bytes) + (34 + 8 * size_bytes - 1) // 4


def cycle_bits_worst(sizes_bytes: Iterable[int]) -> int:
    """Worst-case bits of one SYNC cycle.

    Parameters
    ----------
    sizes_bytes : iterable of int
        Length of every frame of the cycle, the SYNC (0) included.
    """
    return sum(frame_bits_worst(size) for size in sizes_bytes)


def load_percent(bits: float, duration_s: float, bitrate_bit_s: float) -> float:
    """Share of the wire that `bits` take in `duration_s`, in per cent."""
    return 100.0 * bits / (duration_s * bitrate_bit_s)


def largest_rate_hz(bits: int, bitrate_bit_s: float, limit_percent: float = 100.0) -> float:
    """Cycles per second that fit under a limit."""
    return bitrate_bit_s * limit_percent / 100.0 / bits
