"""Preview of a log with a map: first values, ranges and problems."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Rows that are shown.
SHOWN: Final = 3
#: A speed that is so far from the change of its angle, as a ratio, is in another unit or has another sign.
_OFF: Final = 0.3
#: Largest torque of an axis that no arm has [Nm], and the smallest that is no noise of a sensor.
_LARGEST_NM: Final = 1e5


@dataclass(frozen=True, slots=True)
class PreviewColumn:
    """Column of the preview: source, first values, range, and suspected error."""

    name: str
    source: str
    first: tuple[float, ...]
    least: float
    most: float
    remark: str


def preview(time_s: Floats, values: Mapping[str, Floats], sources: Mapping[str, str]) -> Iterator[PreviewColumn]:
    """Describe columns (n,) of a table, in the row order of the log.

    Parameters
    ----------
    time_s : array of shape (n,)
    values : mapping of str to array of shape (n,)
    sources : mapping of str to str
        Column of the log, and its unit, by column of the table.
    """
    yield _column("time_s", sources.get("time_s", ""), time_s, "")
    for name, cells in values.items():
        yield _column(name, sources.get(name, ""), cells, "; ".join(_odd(name, cells, time_s, values)))


def _column(name: str, source: str, cells: Floats, remark: str) -> PreviewColumn:
    return PreviewColumn(name, source, tuple(cells[:SHOWN].tolist()), float(cells.min()), float(cells.max()), remark)


def _odd(name: str, cells: Floats, time_s: Floats, values: Mapping[str, Floats]) -> Iterator[str]:
    if len(cells) > 1 and not np.ptp(cells) and (cells[0] or name.startswith(("tau", "i"))):
        yield "never changes"
    if name.startswith("q") and name.endswith("_rad") and np.abs(cells).max() > 2 * math.pi:
        yield "range above one revolution: is it a motor angle (set gear_ratio), or in another unit?"
    if name.endswith("_nm") and np.abs(cells).max() > _LARGEST_NM:
        yield f"beyond {_LARGEST_NM:g} Nm: is the unit mNm?"
    if name.startswith("qd") and name.endswith("_rad_s"):
        yield from _against_angle(cells, values.get(f"q{name[2:-6]}_rad"), time_s)


def _against_angle(speed: Floats, angle: Floats | None, time_s: Floats) -> Iterator[str]:
    """Return how a speed disagrees with the change of its angle; empty if it agrees."""
    if angle is None or len(time_s) < SHOWN or np.ptp(time_s) <= 0:
        return
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))])
    travelled, moved = travelled - travelled.mean(), angle - angle.mean()
    if not moved @ moved > 1e-6 * len(moved):
        return
    ratio = float(travelled @ moved / (moved @ moved))
    if abs(ratio - 1.0) > _OFF:
        what = "the other sign" if ratio < 0 else "another unit"
        yield f"is {ratio:.3g} times the change of the angle: {what}?"
