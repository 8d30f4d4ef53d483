"""Moving runs of an arm without bus, drives or time steps: a motion that is repeated, and what the drives report.

The links' torque is PyBullet's, once a period; friction, gear, filter and noise are added on a grid that is finer than
the samples. Speeds and accelerations are computed from the reported position, as in a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfilter_zi, resample

from benchmarks.nature.moving_arm import MovingArm
from benchmarks.nature.moving_effects import MovingEffect
from sim.engine import Engine

Array = NDArray[np.float64]
#: times (n,) -> positions, speeds, accelerations (n, N) and further arrays, which are not used
States = Callable[[Array], Sequence[Array]]

#: Steps from one sample to the next.
FINE = 8
#: Minimum samples per second of the links' torque; it has no faster components.
RIGID_HZ = 50.0
#: Harmonics of a period up to which a bent gear follows.
RIGID_HARMONICS = 40


@dataclass(frozen=True, slots=True)
class PeriodicMotion:
    """A motion from rest to rest that is repeated without a stop.

    Attributes
    ----------
    states : positions, speeds and accelerations at times within a period
    period_s, periods : how long, and how often
    rate_hz : samples a second
    harmonics : highest harmonic of the period that is looked for in the reported position
    number : what the motion is known by in `x_excitation`
    """

    states: States
    period_s: float
    periods: int
    rate_hz: float
    harmonics: int
    number: int = 1

    @property
    def samples(self) -> int:
        """Of one period."""
        return round(self.period_s * self.rate_hz)


def measure_moving(
    arm: MovingArm,
    motion: PeriodicMotion,
    load: str,
    start_s: float,
    rng: np.random.Generator,
    effect: MovingEffect | None = None,
) -> dict[str, NDArray[Any]]:
    """Columns of a measured table of one run.

    Parameters
    ----------
    load : `none`, or the label of the tool
    start_s : time since the arm was cold, of the first sample
    effect : mechanism beyond what the owner states
    """
    count = motion.samples
    shown, drive = reported_nm(arm, motion, load, start_s, rng, effect)
    seen = shown[::FINE] + electrical_noise(arm, len(drive), motion.rate_hz, rng)
    q, qd, qdd = reported_motion(arm, motion, rng)
    phase = np.tile(np.arange(count) / motion.rate_hz, motion.periods)
    period = np.repeat(np.arange(1, motion.periods + 1), count)
    return {
        "run": np.full(len(drive), load),
        "load": np.full(len(drive), load),
        "time_s": start_s + drive,
        "q_rad": q,
        "qd_rad_s": qd,
        "qdd_rad_s2": qdd,
        "tau_nm": np.round(seen / arm.resolution_nm) * arm.resolution_nm,
        "x_excitation": np.full(len(drive), float(motion.number)),
        "x_period": period.astype(float),
        "x_phase_s": phase,
    }


def reported_nm(
    arm: MovingArm,
    motion: PeriodicMotion,
    load: str,
    start_s: float,
    rng: np.random.Generator,
    effect: MovingEffect | None = None,
) -> tuple[Array, Array]:
    """Torque behind the drives' filters on the fine grid (FINE n, N), and the times of the samples (n,); no noise."""
    count = motion.samples * FINE
    fine_s = np.arange(count) / (FINE * motion.rate_hz)
    q, qd, qdd = (np.asarray(part) for part in motion.states(fine_s)[:3])
    parts = []
    strokes = _strokes(qd, motion.periods)
    scale = 1.0 + arm.friction.tail_share * _student(arm, strokes.max() + 1, rng)
    for number in range(motion.periods):
        here = strokes[number * count : (number + 1) * count]
        level = np.take_along_axis(scale, here, axis=0)
        acting = arm if effect is None or effect.arm is None else effect.arm(arm, number)
        if number == 0 or acting is not arm:
            links_nm = rigid_nm(acting, motion, load)
        tau, time_s = links_nm, start_s + number * motion.period_s + fine_s
        if effect is not None and effect.angle_rad is not None:
            tau = _bent_nm(acting, motion, load, effect.angle_rad(q, tau))
        if effect is not None and effect.joint_nm is not None:
            tau = tau + effect.joint_nm(q, tau)
        motor = _motor_nm(acting, (q, qd, qdd), tau, level, time_s)
        reported = effect is None or effect.reading_nm is None
        parts.append(motor if reported else effect.reading_nm(motor, q, time_s))
    step_s = 1.0 / (FINE * motion.rate_hz)
    return _filtered(arm, np.concatenate(parts), step_s), np.arange(motion.samples * motion.periods) / motion.rate_hz


def rigid_nm(arm: MovingArm, motion: PeriodicMotion, load: str) -> Array:
    """Return the torque of links and load over one period on the fine grid."""
    coarse = max(int(np.ceil(RIGID_HZ * motion.period_s)), 8 * motion.harmonics)
    times = np.arange(coarse) * motion.period_s / coarse
    q, qd, qdd = (np.asarray(part) for part in motion.states(times)[:3])
    with Engine([arm.carrying(load)], arm.gravity_m_s2) as dynamics:
        return np.asarray(resample(dynamics.torque_nm(q, qd, qdd), motion.samples * FINE, axis=0))


def _bent_nm(arm: MovingArm, motion: PeriodicMotion, load: str, link_rad: Array) -> Array:
    """Return the torque where the links have other angles (FINE n, N) than the encoders."""
    times = np.arange(len(link_rad)) * motion.period_s / len(link_rad)
    rate = 2j * np.pi * np.arange(RIGID_HARMONICS + 1)[:, None] / motion.period_s
    parts = np.fft.rfft(link_rad, axis=0)[: RIGID_HARMONICS + 1]

    def states(at_s: Array) -> Sequence[Array]:
        orders = [np.fft.irfft(rate**order * parts, len(link_rad), axis=0) for order in range(3)]
        return [np.stack([np.interp(at_s, times, axis) for axis in values.T], axis=1) for values in orders]

    return rigid_nm(arm, replace(motion, states=states), load)


def friction_nm(arm: MovingArm, qd_rad_s: Array, tau_nm: Array, level: Array, time_s: Array) -> Array:
    """What friction takes of the torque (n, N); `level` is how its Coulomb part differs from stroke to stroke."""
    cold = arm.friction.cold(time_s)
    at_rest = arm.breakaway_share * np.exp(-((np.abs(qd_rad_s) / arm.stribeck_rad_s) ** arm.stribeck_power))
    own = arm.friction.coulomb_nm * cold
    band = arm.friction.band_nm(tau_nm, time_s) + own * (level - 1.0 + at_rest)
    return np.sign(qd_rad_s) * band + arm.friction.bias_share * band + arm.viscous_nm_s_rad * cold * qd_rad_s


def _motor_nm(arm: MovingArm, states: Sequence[Array], tau_nm: Array, level: Array, time_s: Array) -> Array:
    q, qd, qdd = states
    behind = tau_nm + friction_nm(arm, qd, tau_nm, level, time_s) + arm.rotor_inertia_kg_m2 * qdd
    turn = arm.gear_ratio * q
    waves = np.stack([np.sin(turn), np.cos(turn), np.sin(2.0 * turn), np.cos(2.0 * turn)], axis=2)
    motor = arm.friction.motor_nm(behind, np.sign(qd))
    return (1.0 + arm.gain) * motor + np.einsum("nac,ac->na", waves, arm.cogging_nm)


def _strokes(qd_rad_s: Array, periods: int) -> NDArray[np.int_]:
    """Number of the stroke, from one reversal to the next, at every step of all periods (n, N)."""
    forth = np.tile(qd_rad_s > 0, (periods, 1))
    turned = np.diff(forth, axis=0, prepend=forth[:1]) != 0
    return np.cumsum(turned, axis=0)


def _student(arm: MovingArm, count: int, rng: np.random.Generator) -> Array:
    """Scatter (count, N) of unit variance with the tails of the arm's friction."""
    freedom = arm.friction.tail_freedom
    normal = rng.standard_normal((count, len(arm.rated_nm)))
    return normal / np.sqrt(rng.chisquare(freedom, (count, 1)) / (freedom - 2.0))


def _filtered(arm: MovingArm, motor_nm: Array, step_s: float) -> Array:
    """Return the reported signal: a first-order filter, then a pure delay."""
    out = np.empty_like(motor_nm)
    times = np.arange(len(motor_nm)) * step_s
    for axis, (lag_s, dead_s) in enumerate(zip(arm.filter_s, arm.dead_s, strict=True)):
        # exact for piecewise linear signals
        keep, steps = np.exp(-step_s / lag_s), lag_s / step_s
        now = 1.0 - steps * (1.0 - keep)
        forward, back = [now, 1.0 - now - keep], [1.0, -keep]
        smooth, _ = lfilter(forward, back, motor_nm[:, axis], zi=lfilter_zi(forward, back) * motor_nm[0, axis])
        out[:, axis] = np.interp(times - dead_s, times, smooth)
    return out


def electrical_noise(arm: MovingArm, count: int, rate_hz: float, rng: np.random.Generator) -> Array:
    """Noise (count, N) of the torque reading: an autocorrelated part, and a white one."""
    keep = np.exp(-1.0 / (rate_hz * arm.noise_s))
    out = np.sqrt(arm.white_share) * rng.standard_normal((count, len(keep)))
    for axis, factor in enumerate(keep):
        drive = np.sqrt(1.0 - factor**2) * rng.standard_normal(count)
        begun = [factor * rng.standard_normal()]
        out[:, axis] += np.sqrt(1.0 - arm.white_share) * lfilter([1.0], [1.0, -factor], drive, zi=begun)[0]
    return arm.noise_nm * out


def reported_motion(arm: MovingArm, motion: PeriodicMotion, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Positions, speeds and accelerations (n, N) of all periods, from the harmonics of the counts of each period."""
    count = motion.samples
    q = np.asarray(motion.states(np.arange(count) / motion.rate_hz)[0])
    rate = 2j * np.pi * np.arange(motion.harmonics + 1)[:, None] / motion.period_s
    reported: list[Sequence[Array]] = []
    for _ in range(motion.periods):
        jitter = 0.3 * arm.count_rad * rng.standard_normal(q.shape)
        counts = np.round((q + jitter) / arm.count_rad) * arm.count_rad
        part = np.fft.rfft(counts, axis=0)[: motion.harmonics + 1]
        reported.append([np.fft.irfft(rate**order * part, count, axis=0) for order in range(3)])
    position, speed, acceleration = (np.concatenate(parts) for parts in zip(*reported, strict=True))
    return position, speed, acceleration
