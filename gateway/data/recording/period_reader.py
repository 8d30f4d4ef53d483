"""Read the periods of a recording, and the excitations that were driven."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from gateway.data.period import KINDS, Period, harmonics_of, why_aliased
from gateway.data.recording.hdf5_text import Hdf5Group
from gateway.data.recording.samples import finite, read_samples, require_length

#: A period is a whole number of SYNCs to within this share of one SYNC.
WHOLE: Final = 0.25


def read_excitations(place: Hdf5Group) -> dict[int, dict[str, Any]]:
    """Return the excitations by fingerprint, as plain values; empty if the arm was not moved.

    Raises
    ------
    InputError
        An excitation is not JSON, or its name is not a number.
    """
    if not place.has("excitations"):
        return {}
    known = place.inside("excitations")
    found: dict[int, dict[str, Any]] = {}
    for name in known.group.attrs:
        if not (name.isascii() and name.isdigit() and len(name) <= 10):
            raise known.refuse(f"@{name}", "is not a number of an excitation")
        found[int(name)] = known.document(name, dict, {})
    return found


def read_periods(
    place: Hdf5Group, axes: int, torque_unit_nm: np.ndarray | None, excitations: dict[int, dict[str, Any]]
) -> tuple[Period, ...]:
    """Return the periods of an arm in measurement order.

    Raises
    ------
    InputError
        A period has invalid attributes, or lacks a SYNC although it is marked complete.
    """
    if not place.has("periods"):
        return ()
    periods = place.inside("periods")
    found = []
    for name in periods.names():
        if not (name.isascii() and name.isdigit() and len(name) < 10):
            raise periods.refuse(name, "is not a number of a period")
        found.append(_period(periods.inside(name), int(name), (axes, torque_unit_nm), excitations))
    return tuple(sorted(found, key=lambda period: period.number))


def _period(
    place: Hdf5Group, number: int, units: tuple[int, np.ndarray | None], excitations: dict[int, dict[str, Any]]
) -> Period:
    axes, torque_unit_nm = units
    arrays = read_samples(place, axes, torque_unit_nm)
    arrays["target_rad"] = finite(place, "target_rad", axes)
    require_length(place, arrays, len(arrays["sync_index"]))
    period = Period(
        number=number,
        load=place.label("load"),
        excitation=place.integer("excitation"),
        name=place.text("name"),
        kind=place.text("kind"),
        joint=place.integer("joint"),
        period=place.integer("period"),
        speed=place.number("speed"),
        period_s=place.number("period_s"),
        complete=bool(place.integer("complete")),
        incomplete_epochs=place.integer("incomplete_epochs", 0),
        **arrays,
        temperature_c=place.optional_numbers("temperature_c", axes),
    )
    _require_labels(place, period, axes)
    if period.excitation not in excitations:
        raise place.refuse("@excitation", f"is {period.excitation}; the file does not contain that excitation")
    if period.complete:
        _require_whole(place, period, harmonics_of(excitations[period.excitation]))
    return period


def _require_labels(place: Hdf5Group, period: Period, axes: int) -> None:
    if period.kind not in KINDS or not 0 <= period.joint <= axes or period.period < 1:
        raise place.refuse("", "load, kind, joint or period has an invalid value")
    if not (0 < period.speed <= 1 and period.period_s > 0):
        raise place.refuse("@speed", "speed must be above 0 and at most 1, period_s above 0")


def _require_whole(place: Hdf5Group, period: Period, harmonics: int) -> None:
    """Check that a complete period contains every SYNC, a whole number of them, and enough for its harmonics."""
    steps = np.diff(period.sync_index)
    if (steps != 1).any():
        at = int(np.argmax(steps != 1))
        one, two = period.sync_index[at : at + 2].tolist()
        raise place.refuse("sync_index", f"SYNC {one} is followed by {two}, but the period is marked complete")
    n = len(period)
    apart_s = float(period.time_s[-1] - period.time_s[0]) / max(n - 1, 1)
    if not (apart_s > 0 and abs(n * apart_s - period.period_s) < WHOLE * apart_s):
        raise place.refuse(
            "@period_s",
            f"is {period.period_s:g} s, and {n} SYNCs that are {apart_s:g} s apart are {n * apart_s:g} s: a period is "
            "a whole number of SYNCs",
        )
    reason = why_aliased(n, harmonics)
    if reason is not None:
        raise place.refuse("time_s", reason)
