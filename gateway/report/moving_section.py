"""Values and figures of a moving identification.

Inertia of the load, friction over speed, rotors, delays, one period of a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from gateway.identify.motion.stretches import Stretches
from gateway.report import notation
from gateway.report.svg import limits, line_chart
from gateway.result.inertia import COLUMN, ROW, tensor_of
from gateway.result.numerals import half_width, interval_text, with_interval
from gateway.result.result import AxisMotion, LoadResult, Result, Rows

Floats = NDArray[np.float64]

PARTS = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
#: Number of points of a friction curve, and of measured samples drawn with it.
CURVE_POINTS, MOST_POINTS = 81, 300
#: Share of the highest speed below which the friction direction is unclear; such samples are not drawn.
SLOW_SHARE = 0.03
#: A joint with a smaller range in a run counts as still [rad].
STILL_RAD = 0.01


@dataclass(frozen=True, slots=True)
class InertiaView:
    """Inertia of a load about its centre of gravity, axes of `frame` [kg m2]: texts with half widths."""

    frame: str
    parts: tuple[tuple[str, str, str], ...]
    principal: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FrictionView:
    """Friction of one axis without load torque over speed from 0: curve, band (empty = unknown), points."""

    joint: int
    speed_rad_s: tuple[float, ...]
    torque_nm: tuple[float, ...]
    half_nm: tuple[float, ...]
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPeriod:
    """Samples of one run in time order: arrays of shape (n,) and (n, N)."""

    run: str
    load: str
    time_s: Floats
    q_rad: Floats
    tau_nm: Floats
    model_nm: Floats

    @property
    def joints(self) -> list[int]:
        """Return the joints (from 0) with at least one torque."""
        return np.flatnonzero(np.isfinite(self.tau_nm).any(axis=0)).tolist()


def inertia_view(load: LoadResult) -> InertiaView | None:
    """Return the table of the inertia, or None if unknown."""
    if load.inertia_kg_m2 is None or not any(map(notation.known, load.inertia_kg_m2)):
        return None
    value = np.array(load.inertia_kg_m2)
    std = np.array(load.inertia_std_kg_m2 or (math.nan,) * len(PARTS))
    shown = [notation.plus_minus(*both) for both in zip(value.tolist(), half_width_of(std).tolist(), strict=True)]
    parts = tuple((name, text, half) for name, (text, half) in zip(PARTS, shown, strict=True))
    return InertiaView(load.frame, parts, _principal(value, std))


def half_width_of(std: Floats) -> Floats:
    """Return half widths (n,) of 95 % intervals from standard deviations (n,)."""
    return np.array([half_width(float(one)) for one in std])


def _principal(value: Floats, std: Floats) -> tuple[str, ...]:
    """Return principal moments, largest first, with first-order intervals; empty if a component is unknown."""
    if not np.isfinite(value).all():
        return ()
    size, turn = np.linalg.eigh(tensor_of(value.tolist()))
    slope = turn[ROW] * turn[COLUMN] * np.where(ROW == COLUMN, 1.0, 2.0)[:, None]
    spread = np.sqrt(np.sum((slope * std[:, None]) ** 2, axis=0))
    return tuple(with_interval(float(size[k]), float(spread[k])) for k in (2, 1, 0))


# -- axes --------------------------------------------------------------------------------------------------------------

#: Text with unit, value and standard deviation of an axis, factor to the unit.
Quantity = tuple[str, Callable[[AxisMotion], tuple[float, float]], float]
QUANTITIES: tuple[Quantity, ...] = (
    ("Coulomb friction [Nm]", lambda axis: (axis.coulomb_nm, axis.coulomb_std_nm), 1.0),
    ("viscous friction [Nm s/rad]", lambda axis: (axis.viscous_nm_s_rad, axis.viscous_std_nm_s_rad), 1.0),
    ("breakaway friction above Coulomb [Nm]", lambda axis: (axis.breakaway_nm, axis.breakaway_std_nm), 1.0),
    ("Stribeck speed [rad/s]", lambda axis: (axis.stribeck_rad_s, math.nan), 1.0),
    ("load-dependent friction [% of the torque]", lambda axis: (axis.load_friction, axis.load_friction_std), 100.0),
    ("rotor inertia [kg m2]", lambda axis: (axis.rotor_inertia_kg_m2, axis.rotor_inertia_std_kg_m2), 1.0),
    ("delay of torque behind position [ms]", lambda axis: (axis.delay_s, axis.delay_std_s), 1000.0),
)


def axis_rows(motion: Sequence[AxisMotion], axes: int) -> list[tuple[str, list[str]]]:
    """Return identified parameters of each axis: text and a value per axis; unknown quantities are omitted.

    Parameters
    ----------
    motion : sequence of AxisMotion
    axes : int
        Number of axes; an axis without motion gets dashes.
    """
    known = {axis.joint: axis for axis in motion}
    rows = []
    for said, of, factor in QUANTITIES:
        pairs = [of(known.get(joint, AxisMotion(joint))) for joint in range(1, axes + 1)]
        if any(notation.known(value) for value, _ in pairs):
            rows.append((said, [_text(factor * value, factor * std) for value, std in pairs]))
    return rows


def _text(value: float, std: float) -> str:
    return interval_text(value, half_width(std)) if notation.known(value) else notation.plain(None)


def friction_nm(axis: AxisMotion, speed_rad_s: Floats) -> Floats:
    """Return the friction (n,) [Nm] at speeds (n,) >= 0, without load torque."""
    return (
        axis.coulomb_nm
        + _known(axis.viscous_nm_s_rad) * speed_rad_s
        + _known(axis.breakaway_nm - axis.coulomb_nm) * _onset(axis, speed_rad_s)
    )


def _known(value: float) -> float:
    return value if notation.known(value) else 0.0


def _onset(axis: AxisMotion, speed_rad_s: Floats) -> Floats:
    """Return the Stribeck factor (n,) between 1 (standstill) and 0."""
    if not axis.stribeck_rad_s > 0.0 or not notation.known(axis.breakaway_nm):
        return np.zeros_like(speed_rad_s)
    return np.exp(-((speed_rad_s / axis.stribeck_rad_s) ** 2))


def friction_views(result: Result) -> list[FrictionView]:
    """Return friction over speed of each axis with known Coulomb friction."""
    measured = _moving_runs(result.rows)
    views = []
    for axis in sorted(result.motion, key=lambda one: one.joint):
        fastest = _fastest(axis, measured)
        if notation.known(axis.coulomb_nm) and fastest > 0.0:
            speed = np.linspace(0.0, fastest, CURVE_POINTS)
            torque, left = friction_nm(axis, speed), _onset(axis, speed)
            shares = (
                ((1.0 - left) * axis.coulomb_std_nm) ** 2,
                (left * _known(axis.breakaway_std_nm)) ** 2,
                (speed * _known(axis.viscous_std_nm_s_rad)) ** 2,
            )
            half = half_width_of(np.sqrt(np.sum(shares, axis=0)))
            views.append(
                FrictionView(
                    joint=axis.joint,
                    speed_rad_s=tuple(speed.tolist()),
                    torque_nm=tuple(torque.tolist()),
                    half_nm=tuple(half.tolist()) if np.isfinite(half).all() else (),
                    points=_points(axis, fastest, measured),
                )
            )
    return views


def _fastest(axis: AxisMotion, runs: Sequence[DrawnPeriod]) -> float:
    if axis.speed_rad_s > 0.0:
        return axis.speed_rad_s
    speeds = [np.abs(_speed(run)[:, axis.joint - 1]).max() for run in runs if axis.joint <= run.q_rad.shape[1]]
    return float(max(speeds, default=0.0))


def _points(axis: AxisMotion, fastest: float, runs: Sequence[DrawnPeriod]) -> tuple[tuple[float, float], ...]:
    """Return speed and friction of measured samples: residual plus modelled friction."""
    column, found = axis.joint - 1, []
    for run in runs:
        if axis.joint > run.q_rad.shape[1] or np.ptp(run.q_rad[:, column]) < STILL_RAD:
            continue
        speed = _speed(run)[:, column]
        left = run.tau_nm[:, column] - run.model_nm[:, column]
        used = (np.abs(speed) > SLOW_SHARE * fastest) & np.isfinite(left)
        sliding = np.sign(speed) * friction_nm(axis, np.abs(speed))
        found.append(np.column_stack([speed, left + sliding])[used])
    rows = np.concatenate(found) if found else np.empty((0, 2))
    chosen = rows[:: 1 + len(rows) // MOST_POINTS]
    return tuple((float(x), float(y)) for x, y in chosen)


# -- one period --------------------------------------------------------------------------------------------------------


def period_of(result: Result) -> DrawnPeriod | None:
    """Return the moving run to draw: most moving joints, with load, fastest; None without motion.

    Slow trial periods precede the measurement and are not representative.
    """
    runs = _moving_runs(result.rows)
    if not runs:
        return None

    def rank(run: DrawnPeriod) -> tuple[int, bool, float, int]:
        moved = int(np.sum(np.ptp(run.q_rad, axis=0) > STILL_RAD))
        mean_rad_s = float(np.abs(np.diff(run.q_rad, axis=0)).sum() / run.time_s[-1])
        return moved, run.load != "none", round(mean_rad_s, 1), len(run.time_s)

    return max(runs, key=rank)


def _moving_runs(rows: Rows | None) -> list[DrawnPeriod]:
    """Return the moving samples in time order, without a gap: an excitation of a recording under a load."""
    if rows is None or not (rows.q_rad and rows.time_s and rows.tau_nm and rows.model_nm):
        return []
    pose = rows.pose or (-1,) * len(rows.q_rad)
    runs, loads = rows.run or ("",) * len(pose), rows.load or ("none",) * len(pose)
    time_s = np.array(rows.time_s, dtype=float)
    time_s[np.array(pose) >= 0] = np.nan
    occasion = np.unique(np.stack([runs, loads]), axis=1, return_inverse=True)[1].ravel()
    # a recording that was continued begins its time again
    part = np.cumsum((np.diff(occasion, prepend=-1) != 0) | (np.diff(time_s, prepend=-np.inf) <= 0.0))
    q_rad, tau_nm, model_nm = (np.array(table, dtype=float) for table in (rows.q_rad, rows.tau_nm, rows.model_nm))
    return [
        DrawnPeriod(runs[chosen[0]], loads[chosen[0]], at_s - at_s[0], q_rad[chosen], tau_nm[chosen], model_nm[chosen])
        for chosen, at_s in Stretches.of(part, time_s).parts
    ]


def _speed(run: DrawnPeriod) -> Floats:
    """Return speeds (n, N) [rad/s] from differences."""
    return np.asarray(np.gradient(run.q_rad, run.time_s, axis=0))


LEFT_PX = 52.0


def sliding_figure(view: FrictionView) -> tuple[str, Markup]:
    """Draw friction over speed in both directions, with its 95 % band and measured samples."""
    half = view.half_nm or (0.0,) * len(view.torque_nm)
    top = [value + more for value, more in zip(view.torque_nm, half, strict=True)]
    fastest, name = view.speed_rad_s[-1], notation.axis(view.joint)
    lines, bands = [], []
    for sense in (-1.0, 1.0):
        speed, torque = ([sense * value for value in values] for values in (view.speed_rad_s, view.torque_nm))
        lines.append((speed, torque, "curve"))
        if view.half_nm:
            low, high = (
                [value + sense * side * more for value, more in zip(torque, half, strict=True)] for side in (-1.0, 1.0)
            )
            bands.append((speed, low, high, "confidence"))
    xs, ys = [x for x, _ in view.points], [y for _, y in view.points]
    return "", line_chart(
        f"Friction of {name} over its speed",
        ("joint speed [rad/s]", f"{name} friction [Nm]"),
        lines,
        dots=[(xs, ys, "dot faint", 1.8, "")],
        bands=bands,
        x_range=limits((-fastest, fastest, *xs), pad=0.03),
        y_range=limits([*top, *(-value for value in top), *ys], include=(0.0,)),
        size=(330.0, 200.0),
        left=LEFT_PX,
    )


def period_figures(period: DrawnPeriod) -> list[list[tuple[str, Markup]]]:
    """Draw for each measured axis over time: position, torque with model, residual.

    Curves are interrupted while the axis is still: torque at standstill is not modelled.
    """
    time_s, rows = period.time_s.tolist(), []

    def chart(describe: str, label: str, values: Floats, kind: str, measured: Floats | None = None) -> Markup:
        dots = [] if measured is None else [(time_s, measured.tolist(), "dot faint", 1.8, "")]
        lines = [(time_s, values.tolist(), kind)]
        labels = ("time in the period [s]", label)
        return line_chart(describe, labels, lines, dots=dots, left=LEFT_PX)

    for axis in period.joints:
        name, measured, model = notation.axis(axis + 1), period.tau_nm[:, axis], period.model_nm[:, axis]
        degrees, left = period.q_rad[:, axis] * (180.0 / math.pi), measured - model
        charts = (
            chart(f"Position of {name} over one period", f"{name} position [deg]", degrees, "curve"),
            chart(
                f"Torque of {name} over one period, measured and modelled",
                f"{name} torque [Nm]",
                model,
                "model-line",
                measured,
            ),
            chart(f"Measured minus modelled torque of {name} over one period", f"{name} residual [Nm]", left, "force"),
        )
        rows.append([("", one) for one in charts])
    return rows
