"""Prepare moving runs for identification: samples of torque and motion, and the rigid-body regressor.

Friction at standstill is not determined by the speed. The torque of an axis is therefore not used in samples where it
turns slower than `SLOW` of its top speed. The other axes of the sample are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.data.periods import PHASE_S, excitation_runs, noise_between_periods
from gateway.data.table import Table
from gateway.errors import DataUnusable
from gateway.model.regressor import regressor
from gateway.model.robot import Robot
from gateway.model.visits import Gears

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLOW = 0.01
#: Smallest top speed [rad/s] that is assumed: 1 % of a lower one is noise of a differentiated encoder.
LEAST_TOP_RAD_S = 0.1
#: Coulomb friction in motion is `tanh(qd / SMOOTH_RAD_S)` [rad/s], in fits, plans and predictions. A
#: joint speed of 0.02 rad/s is well above the error of differentiated encoder counts.
SMOOTH_RAD_S: Final = 0.02
LARGEST = 1600
PER_BODY = 10
STEP_RAD = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class MovingRows:
    """Samples of one or more moving runs.

    Attributes
    ----------
    robot : Robot
    gravity_m_s2 : array of shape (3,)
    time_s : array of shape (n,)
        Time since the start of the run.
    run : int array of shape (n,)
        Number of the run; the samples of a run are in time order. All periods of one excitation under one load are one
        run.
    phase_s : array of shape (n,)
        Time since the start of the period; `time_s` if nothing repeats.
    load : str array of shape (n,)
    held_out : bool array of shape (n,)
        Sample of the hold-out data of the user, which no fit uses.
    q_rad, qd_rad_s, qdd_rad_s2, tau_nm : arrays of shape (n, N)
        Torque is 0 where not measured.
    judged : bool array of shape (n, N)
        The axis is measured and moves.
    sign : array of shape (n, N)
        Smooth sign of the velocity.
    speed_rad_s : array of shape (N,)
        Top speed of each axis.
    rigid : array of shape (n, N, 10 N)
        Rigid body regressor, ten columns per link.
    wind_up_rad : array of shape (n, N)
        Angle of the secondary encoder minus that of the motor encoder, NaN without one. With one, `q_rad` is the angle
        of the link.
    temperature_c : array of shape (n, N)
        NaN where absent.
    floor_nm : array of shape (N,)
        Noise of a torque reading, from the differences between periods of one excitation; NaN if nothing repeats.
    delay_s : array of shape (N,)
        Delay of the torque of an axis relative to its motion.
    """

    robot: Robot
    gravity_m_s2: Floats
    time_s: Floats
    run: NDArray[np.int_]
    phase_s: Floats
    load: NDArray[np.str_]
    held_out: Mask
    q_rad: Floats
    qd_rad_s: Floats
    qdd_rad_s2: Floats
    tau_nm: Floats
    judged: Mask
    sign: Floats
    speed_rad_s: Floats
    rigid: Floats
    wind_up_rad: Floats
    temperature_c: Floats
    floor_nm: Floats
    delay_s: Floats
    _derivatives: dict[tuple[str, int], Floats] = field(init=False, repr=False, default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.time_s)

    @property
    def axes(self) -> int:
        """Number of axes of the arm."""
        return self.q_rad.shape[1]

    def by_angle(self, axis: int) -> Floats:
        """Return the derivative of the rigid-body regressor with respect to one joint angle [1/rad]."""
        if ("angle", axis) not in self._derivatives:
            self._derivatives["angle", axis] = angle_derivative(self, axis)
        return self._derivatives["angle", axis]

    def by_tilt(self, direction: int) -> Floats:
        """Return the derivative of the rigid-body regressor with respect to base tilt about x (0) or y (1)."""
        if ("tilt", direction) not in self._derivatives:
            self._derivatives["tilt", direction] = tilt_derivative(self, direction)
        return self._derivatives["tilt", direction]

    @property
    def measured(self) -> Mask:
        """Mask of the axes (N,) with usable samples."""
        return np.asarray(self.judged.any(axis=0))

    @property
    def duration_s(self) -> float:
        """Length of the longest run [s]."""
        return max(float(np.ptp(self.time_s[self.run == number])) for number in np.unique(self.run))


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """Modelled torque of moving samples.

    Attributes
    ----------
    rigid_nm, total_nm : arrays of shape (n, N)
        Torque of the rigid bodies and all torque.
    body : array of shape (n, 10 N)
        Link parameters of each sample, with the load on the last link.
    load_kg : array of shape (n,)
        Mass of the load alone.
    """

    rigid_nm: Floats
    total_nm: Floats
    body: Floats
    load_kg: Floats


def changed_torque(change: Floats, modelled: Modelled) -> Floats:
    """Return the torque (n, N) of a changed regressor (n, N, 10 N) with the link parameters of each sample."""
    return np.einsum("nap,np->na", change, modelled.body)


def smooth_sign(speed_rad_s: Floats, top_rad_s: float | Floats) -> Floats:
    """Return the smooth sign of a velocity, scaled by the top speed (same shape as `speed_rad_s`)."""
    return np.tanh(speed_rad_s / rounding_rad_s(top_rad_s))


def rounding_rad_s(top_rad_s: float | Floats) -> Floats:
    """Return the speed below which the sign of a velocity is smoothed (same shape as `top_rad_s`).

    A search of effects scales it by the top speed, because a large arm turns slowly. On a KR300 (0.5 rad/s),
    `SMOOTH_RAD_S` gives a residual of 238 instead of 178 Nm on J2 in held-out blocks of time, and 174 instead of 135 Nm
    on J4. An estimate uses `SMOOTH_RAD_S`, and the speed limit for slow samples, as plans and predictions with its
    friction do. Loads of 37 simulated arms that turn at 1 to 4 rad/s barely differ: 0.80 % rms of the mass, scaled by
    the top speed 0.78 %.
    """
    return SLOW * np.maximum(top_rad_s, LEAST_TOP_RAD_S)


def turns(qd_rad_s: Floats, top_rad_s: Floats, share: float = SLOW) -> Mask:
    """Return a mask where each axis of samples (n, N) turns at least at a share of its top speed (N,)."""
    return np.asarray(np.abs(qd_rad_s) >= share * np.maximum(top_rad_s, LEAST_TOP_RAD_S))


def behind_gears(table: Table, efficiency: ArrayLike | None, coupling: ArrayLike | None = None) -> Table:
    """Return the table with the torque of its moving samples behind gears of stated efficiency, by direction of motion.

    Parameters
    ----------
    table : Table
    efficiency : array of shape (N,), one for all, or None
        1 or None if the torque is already that behind the gear.
    coupling : array of shape (N, N) or None
        As of `Gears`.
    """
    if efficiency is None:
        return table
    behind = Gears.of(efficiency, table.axes, coupling).behind(table.tau_nm, table.qd_rad_s)
    return replace(table, tau_nm=np.where(table.moving[:, None], behind, table.tau_nm))


def at_links(table: Table) -> Table:
    """Return the table with the link angle for axes with a secondary encoder, where the bodies are."""
    seen = np.isfinite(table.q2nd_rad).all(axis=0)
    return replace(table, q_rad=np.where(seen, table.q2nd_rad, table.q_rad)) if seen.any() else table


def prepare(
    table: Table, held_out: Table | None, robot: Robot, gravity_m_s2: Floats, largest: float = LARGEST
) -> MovingRows:
    """Return the samples of moving runs in `table` (to fit) and `held_out` (never fitted), at most `largest`.

    Raises
    ------
    DataUnusable
        No axis has torque samples in motion.
    """
    fitted, fitted_run = _in_time_order(table)
    parts, runs = [fitted], [fitted_run]
    if held_out is not None:
        held, held_run = _in_time_order(held_out)
        parts.append(held)
        runs.append(held_run + fitted_run.max() + 1)
    run = np.concatenate(runs)
    is_held_out = np.concatenate([np.full(len(part), number == 1) for number, part in enumerate(parts)])
    step = max(1, int(np.ceil(len(run) / largest)))
    keep = np.zeros(len(run), dtype=bool)
    keep[::step] = True
    fields = {
        name: np.concatenate([getattr(part, name) for part in parts])[keep]
        for name in ("time_s", "load", "q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm", "q2nd_rad", "temperature_c")
    }
    run, is_held_out = run[keep], is_held_out[keep]
    tau = fields.pop("tau_nm")
    link = fields.pop("q2nd_rad")
    seen = np.isfinite(link).all(axis=0)
    wind_up = np.where(seen, link - fields["q_rad"], np.nan)
    fields["q_rad"] = np.where(seen, link, fields["q_rad"])
    time = fields.pop("time_s").copy()
    for number in np.unique(run):
        time[run == number] -= time[run == number].min()
    in_period = np.concatenate([part.extra.get(PHASE_S, np.full(len(part), np.nan)) for part in parts])[keep]
    speed = np.abs(fields["qd_rad_s"][~is_held_out]).max(axis=0)
    judged = np.isfinite(tau) & turns(fields["qd_rad_s"], speed)
    if not judged[~is_held_out].any():
        raise DataUnusable("no axis moves while its torque is measured; moving samples need speeds above 0.001 rad/s")
    return MovingRows(
        robot=robot,
        gravity_m_s2=np.asarray(gravity_m_s2, dtype=float),
        time_s=time,
        phase_s=np.where(np.isfinite(in_period), in_period, time),
        run=run,
        held_out=is_held_out,
        tau_nm=np.nan_to_num(tau),
        judged=judged,
        sign=smooth_sign(fields["qd_rad_s"], speed),
        speed_rad_s=speed,
        wind_up_rad=wind_up,
        floor_nm=noise_between_periods(fitted, turns(fitted.qd_rad_s, speed)),
        delay_s=np.zeros(robot.axes),
        rigid=_rigid(robot, fields["q_rad"], fields["qd_rad_s"], fields["qdd_rad_s2"], gravity_m_s2),
        **fields,
    )


def _in_time_order(table: Table) -> tuple[Table, NDArray[np.int_]]:
    """Return the moving samples sorted by run and time, and the run number of each sample."""
    moving = table.take(table.moving)
    order, run = time_order(moving)
    return moving.take(order), run


def time_order(moving: Table) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return the order (n,) of moving samples by run and time, and the run number (n,)."""
    repeated = excitation_runs(moving)
    own = np.where(repeated >= 0, np.char.add("\x00", repeated.astype(str)), moving.run.astype(str))
    names = np.char.add(np.char.add(np.asarray(moving.file, dtype=str), "\x00"), own)
    _, first, run = np.unique(names, return_index=True, return_inverse=True)
    run = np.argsort(np.argsort(first))[run]
    order = np.lexsort((moving.time_s, run))
    return order, run[order]


def _rigid(robot: Robot, q_rad: Floats, qd_rad_s: Floats, qdd_rad_s2: Floats, gravity: Floats) -> Floats:
    return np.asarray(regressor(robot, q_rad, qd_rad_s, qdd_rad_s2, tuple(np.asarray(gravity, dtype=float))))


def angle_derivative(motion: MovingRows, axis: int) -> Floats:
    """Return the derivative (n, N, 10 N) [1/rad] of the rigid-body regressor with respect to one joint angle."""
    step = np.zeros(motion.robot.axes)
    step[axis] = STEP_RAD
    ends = [
        _rigid(motion.robot, motion.q_rad + side * step, motion.qd_rad_s, motion.qdd_rad_s2, motion.gravity_m_s2)
        for side in (1.0, -1.0)
    ]
    return (ends[0] - ends[1]) / (2.0 * STEP_RAD)


def tilt_derivative(motion: MovingRows, direction: int) -> Floats:
    """Return the derivative (n, N, 10 N) [1/rad] of the regressor with respect to base tilt about x or y."""
    turn = np.zeros(3)
    turn[direction] = 1.0
    rest = np.zeros_like(motion.q_rad)
    return _rigid(motion.robot, motion.q_rad, rest, rest, -np.cross(turn, motion.gravity_m_s2))
