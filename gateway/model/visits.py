"""Rest visits: both approaches to a pose as half-sum (gravity) and half-difference (friction band) of the torque.

Each torque is first converted through the gear by its own direction: driving, `tau = eta u`; back-driven, `tau = u/eta`
(Li et al., static load identification from servo torque, eq. (9)). A half-sum of `u` would leave a factor (eta +
1/eta)/2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.data.labels import BARE_LABEL
from gateway.data.rows import Table

Floats = NDArray[np.float64]
Mask = NDArray[Any]

#: Largest difference of joint angles within one pose [rad], in all commands. Within 0.01 rad gravity changes by at most
#: 1 % of
#: its torque, less than the scatter of friction; the rest positions after both approaches differ by less.
SAME_POSE_RAD: Final = 0.01
#: Assumed time between visits [s] if the table has none: short, so that no warm-up is assumed.
_ORDER_S = 1e-3
#: Largest entry of an inverted coupling that counts as rounding.
_NO_SHARE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Gears:
    """Gear efficiencies of N motors, and the coupling of their gear outputs to the joints.

    Attributes
    ----------
    efficiency : array of shape (N,)
    coupling : array of shape (N, N) or None
        Gear outputs turn by `coupling @ q`, joint torque is `coupling' f` of gear output torque f; None = one to one.
    """

    efficiency: Floats
    coupling: Floats | None = None

    @staticmethod
    def of(efficiency: ArrayLike | None, axes: int, coupling: ArrayLike | None = None) -> Gears:
        """Return the gears of N axes from one efficiency or one per axis (None = 1), and the coupling."""
        eta = np.broadcast_to(np.asarray(1.0 if efficiency is None else efficiency, dtype=float), (axes,))
        mixed = None if coupling is None else np.asarray(coupling, dtype=float)
        return Gears(eta, None if mixed is None or np.array_equal(mixed, np.eye(axes)) else mixed)

    def behind(self, reported_nm: Floats, direction: Floats | float) -> Floats:
        """Return the joint torque (n, N) [Nm] behind the gears for the torque that loss-free gears would give.

        Parameters
        ----------
        reported_nm : array of shape (n, N)
        direction : array of shape (n, N), or one for all
            Direction or velocity of each joint; with an unknown direction (0) a gear leaves the torque unchanged.
        """
        output, facing = self._outputs(reported_nm, direction)
        work = output * facing
        eta = self.efficiency
        return self._joints(output * np.where(work > 0, eta, np.where(work < 0, 1.0 / eta, 1.0)))

    def before(self, behind_nm: Floats, direction: float) -> Floats:
        """Return the joint torque (n, N) [Nm] of loss-free gears for the torque behind them; inverse of `behind`."""
        output, facing = self._outputs(behind_nm, direction)
        eta = self.efficiency
        return self._joints(np.where(output * facing > 0, output / eta, output * eta))

    def open_range(self, reported_nm: Floats, direction: Floats) -> Floats:
        """Return half the torque range (n, N) [Nm] caused by unknown directions; 0 if all directions are known."""
        output, facing = self._outputs(reported_nm, direction)
        half = np.where(facing == 0, np.abs(output) * (1.0 / self.efficiency - self.efficiency) / 2.0, 0.0)
        return half if self.coupling is None else _mixed(half, np.asarray(np.abs(self.coupling), dtype=float))

    def _outputs(self, joint_nm: Floats, direction: Floats | float) -> tuple[Floats, Floats]:
        """Return torque and direction (n, N) of the gear outputs."""
        facing = np.broadcast_to(np.asarray(direction, dtype=float), np.shape(joint_nm))
        if self.coupling is None:
            return joint_nm, facing
        return _mixed(joint_nm, np.asarray(np.linalg.inv(self.coupling), dtype=float)), facing @ self.coupling.T

    def _joints(self, output_nm: Floats) -> Floats:
        return output_nm if self.coupling is None else _mixed(output_nm, self.coupling)


@dataclass(frozen=True, slots=True, eq=False)
class Visits:
    """Rest visits of one or more recordings, n of them, in the order of their first row.

    Attributes
    ----------
    load, run : str arrays of shape (n,)
    pose : int array of shape (n,)
    time_s : array of shape (n,)
        Middle of the visit; if a time is missing, all visits are numbered a millisecond apart.
    q_rad : array of shape (n, N)
        From the secondary encoder of a joint if all visits have it, else from that of the motor.
    sum_nm : array of shape (n, N)
        Half-sum of both approaches behind the gear, or the torque of the only approach; NaN = axis not measured.
    difference_nm : array of shape (n, N)
        Half-difference of both approaches in the direction of motion. NaN for a single approach, and for axes that
        rested in between.
    side : array of shape (n, N)
        Approach direction of an axis approached in one direction only; 0 = both, or unknown.
    two_sided : bool array of shape (n,)
        True if at least one axis was approached in both directions.
    sample_std_nm : array of shape (n, N)
        Standard deviation of `sum_nm` from the averaged samples only; NaN if unknown.
    gear_nm : array of shape (n, N)
        Half the torque range caused by an unknown direction and the gear efficiency; 0 if the direction is known.
    temperature_c : array of shape (n, N)
        NaN where absent.
    wind_up_rad : array of shape (n, N)
        Angle of the secondary encoder minus that of the motor encoder; NaN without one.
    where : str array of shape (n,)
        `file:line` of the first row, for messages.
    rows : int array of shape (n, 2)
        Rows of both approaches among the rest rows of their table; the same row twice for a single approach.
    gears : Gears
        Gears used to convert the reported torque.
    """

    load: NDArray[np.str_]
    run: NDArray[np.str_]
    pose: NDArray[np.int_]
    time_s: Floats
    q_rad: Floats
    sum_nm: Floats
    difference_nm: Floats
    side: Floats
    two_sided: NDArray[np.bool_]
    sample_std_nm: Floats
    gear_nm: Floats
    temperature_c: Floats
    wind_up_rad: Floats
    where: NDArray[np.str_]
    rows: NDArray[np.int_]
    gears: Gears

    def __len__(self) -> int:
        """Number of visits."""
        return len(self.pose)

    @property
    def axes(self) -> int:
        """Number of axes of the arm."""
        return self.q_rad.shape[1]

    @property
    def band_nm(self) -> Floats:
        """Friction band (N,): median of the half-differences; NaN for an axis without approaches in both directions."""
        return column_medians(self.difference_nm)

    def take(self, rows: NDArray[Any]) -> Visits:
        """Return the chosen visits (mask or indices)."""
        return Visits(gears=self.gears, **{name: getattr(self, name)[rows] for name in _OF_VISITS})

    def of_rows(self, entries: NDArray[np.bool_], rows: int) -> NDArray[np.bool_]:
        """Return which torques (rows, N) of the table's rest rows the entries (n, N) of the visits were made from."""
        mask = np.zeros((rows, self.axes), dtype=bool)
        for approach in self.rows.T:
            mask[approach] |= entries
        return mask

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Mask of the axes (N,) whose torque was measured in any visit."""
        return np.asarray(np.isfinite(self.sum_nm).any(axis=0))

    def unmeasured(self, entries: NDArray[np.bool_]) -> Visits:
        """Return a copy of the visits with entries (n, N) marked as not measured."""
        sums, halves = (np.where(entries, np.nan, values) for values in (self.sum_nm, self.difference_nm))
        return replace(self, sum_nm=sums, difference_nm=halves)


def visits_at(q_rad: Floats, gears: Gears) -> Visits:
    """Return unmeasured visits of postures (n, N), approached in both directions without a load."""
    n, axes = q_rad.shape
    unknown = np.full((n, axes), np.nan)
    return Visits(
        load=np.full(n, BARE_LABEL),
        pose=np.arange(n) + 1,
        run=np.full(n, "next"),
        time_s=np.arange(n, dtype=float),
        q_rad=q_rad,
        sum_nm=np.zeros((n, axes)),
        difference_nm=np.zeros((n, axes)),
        side=np.zeros((n, axes)),
        two_sided=np.ones(n, dtype=bool),
        sample_std_nm=unknown,
        temperature_c=unknown,
        gear_nm=np.zeros((n, axes)),
        wind_up_rad=unknown,
        where=np.full(n, "next"),
        rows=np.repeat(np.arange(n)[:, None], 2, axis=1),
        gears=gears,
    )


_OF_VISITS: Final = tuple(field.name for field in fields(Visits) if field.name != "gears")


def places_of(q_rad: Floats) -> NDArray[np.int_]:
    """Return the place (n,) of joint angles (n, N), numbered from 0: equal within the tolerance of one pose."""
    out, left, place = np.zeros(len(q_rad), dtype=int), np.arange(len(q_rad)), 0
    while len(left):
        near = np.abs(q_rad[left] - q_rad[left[0]]).max(axis=1) < SAME_POSE_RAD
        out[left[near]] = place
        left, place = left[~near], place + 1
    return out


def joined(parts: Sequence[Visits]) -> Visits:
    """Return the visits of several tables as one, in their order."""
    merged = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _OF_VISITS}
    return Visits(gears=parts[0].gears, **merged)


def column_medians(values: Floats) -> Floats:
    """Return the median (N,) of the known values in each column of (n, N); NaN for an empty column."""
    known = np.isfinite(values)
    return np.array(
        [np.median(column[here]) if here.any() else np.nan for column, here in zip(values.T, known.T, strict=True)]
    )


def _mixed(values: Floats, matrix: Floats) -> Floats:
    """Return `values @ matrix`, NaN only where a NaN has a nonzero factor."""
    known = np.isfinite(values)
    missing = (~known).astype(float) @ (np.abs(matrix) > _NO_SHARE).astype(float) > 0
    return np.where(missing, np.nan, np.where(known, values, 0.0) @ matrix)


def pair_visits(table: Table, efficiency: ArrayLike | None = None, coupling: ArrayLike | None = None) -> Visits:
    """Pair the rest samples of a table to visits.

    Two samples of one run, load and pose at the same joint angles, approached in opposite directions, make one visit,
    in time order. Next are pairs in which only some axes reversed; they are two-sided for those axes only. Last are
    sweeps of a single joint that passes the same angle in both directions, whatever their pose numbers. Remaining
    samples make one-sided visits.

    Parameters
    ----------
    table : Table
        Moving samples are left out.
    efficiency : array of shape (N,), optional
        Gear efficiency of each motor; 1 if the torque of the table is already that behind the gear.
    coupling : array of shape (N, N), optional
        As of `Gears`.
    """
    rest = table.take(~table.moving)
    gears = Gears.of(efficiency, rest.axes, coupling)
    facing = rest.direction.astype(float)
    torque = gears.behind(rest.tau_nm, facing)
    open_nm = gears.open_range(rest.tau_nm, facing)
    std = rest.tau_std_nm / np.sqrt(np.maximum(rest.count, 1))[:, None]
    # Rows of the first and second approach; the same row twice for a one-sided visit
    by_pose: dict[tuple[str, str, int], list[int]] = {}
    for row in range(len(rest)):
        by_pose.setdefault((str(rest.run[row]), str(rest.load[row]), int(rest.pose[row])), []).append(row)
    pairs: list[tuple[int, int]] = []
    by_load: dict[tuple[str, str], list[int]] = {}
    for (run, load, _), members in by_pose.items():
        for rule in (_reversed, _partly_reversed):
            found, members = _matched(rest, members, rule)
            pairs += found
        by_load.setdefault((run, load), []).extend(members)
    for members in by_load.values():
        found, alone = _matched(rest, members, _one_reversed)
        pairs += found + [(row, row) for row in alone]
    pairs.sort()
    rows = np.array(pairs, dtype=int).reshape(-1, 2)
    one, other = rows[:, 0], rows[:, 1]
    two = one != other
    half = np.where(two[:, None], np.hypot(std[one], std[other]) / 2.0, std[one])
    moved = two[:, None] & (facing[one] != 0) & (facing[one] == -facing[other])
    time_s: Floats = (rest.time_s[one] + rest.time_s[other]) / 2.0
    motor_rad, joint_rad = ((values[one] + values[other]) / 2.0 for values in (rest.q_rad, rest.q2nd_rad))
    seen = np.isfinite(joint_rad).all(axis=0)
    return Visits(
        load=np.asarray(rest.load, dtype=str)[one],
        run=np.asarray(rest.run, dtype=str)[one],
        pose=np.asarray(rest.pose)[one],
        time_s=_ORDER_S * np.arange(len(one), dtype=float) if np.isnan(time_s).any() else time_s,
        q_rad=np.where(seen, joint_rad, motor_rad),
        sum_nm=(torque[one] + torque[other]) / 2.0,
        difference_nm=np.where(moved, facing[one] * (torque[one] - torque[other]) / 2.0, np.nan),
        side=np.where(moved, 0.0, facing[one]),
        two_sided=two,
        sample_std_nm=half,
        gear_nm=np.maximum(open_nm[one], open_nm[other]),
        temperature_c=(rest.temperature_c[one] + rest.temperature_c[other]) / 2.0,
        wind_up_rad=np.where(seen, joint_rad - motor_rad, np.nan),
        where=np.array([rest.where(int(row)) for row in one], dtype=str),
        rows=np.stack([one, other], axis=1),
        gears=gears,
    )


def _reversed(facing: Mask, others: Mask) -> Mask:
    """Return True where all axes that moved have the opposite direction: directions (N,) against (k, N)."""
    return (others == -facing).all(axis=1) & facing.any()


def _partly_reversed(facing: Mask, others: Mask) -> Mask:
    """Return True where some axes reversed and the others moved as before, or rested."""
    return (np.abs(others) == np.abs(facing)).all(axis=1) & (others != facing).any(axis=1)


def _one_reversed(facing: Mask, others: Mask) -> Mask:
    """Return True where only one axis reversed, and the others moved as before or rested."""
    return _partly_reversed(facing, others) & ((others != facing).sum(axis=1) == 1) & (len(facing) > 1)


def _matched(
    rest: Table, members: list[int], opposite: Callable[[Mask, Mask], Mask]
) -> tuple[list[tuple[int, int]], list[int]]:
    """Return row pairs at the same angles that `opposite` accepts, in time order; and the unpaired rows."""
    if len(members) < 2:
        return [], members
    order = np.array(members, dtype=int)
    order = order[np.lexsort((order, np.nan_to_num(rest.time_s[order])))]
    waiting = np.ones(len(order), dtype=bool)
    pairs: list[tuple[int, int]] = []
    alone: list[int] = []
    for place, row in enumerate(order.tolist()):
        if not waiting[place]:
            continue
        waiting[place] = False
        others = order[waiting]
        away = np.abs(rest.q_rad[others] - rest.q_rad[row]).max(axis=1, initial=0.0)
        near = away < SAME_POSE_RAD
        others, away = others[near], away[near]
        fits = opposite(rest.direction[row], rest.direction[others]) if len(others) else near[:0]
        if not fits.any():
            alone.append(row)
            continue
        # rows of one pose in the order of time; of a sweep, which has no poses, those of the same angle
        partner = int(np.argmin(np.where(fits, away, np.inf))) if opposite is _one_reversed else int(np.argmax(fits))
        pairs.append((row, int(others[partner])))
        waiting[order == others[partner]] = False
    return pairs, alone
