"""Predict torque readings of an arm at rest, with every effect that a hypothesis may contain.

An `AlteredModel` holds all quantities that effects change; `neutral(n)` is the model without effects. `Model.predict`
follows the path of the torque: gravity at the joints, springs and cables, friction by approach direction, gear, torque
constant, report of the drive. Then it applies the conversion of a measurement. Every column of a fit is a derivative of
this prediction, so it contains modelled torque only, never measured torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gateway.model.kinematics import gravity_in_last_link, joint_axes_origins, link_frames
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
_WIND_UP_STEPS = 6
_NEAR_RAD = 1e-3
#: Joint step [rad] for numerical derivatives of the rows.
_SLOPE_STEP_RAD = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class AlteredModel:
    """Quantities that effects change, for n visits.

    Attributes
    ----------
    tilt_rad : (2,) rotation vector (x, y) of the base
    zero_offset_rad, compliance_rad_nm : (N,) true angle = q + offset - compliance * torque (offset also by visit)
    play_rad : (N,) play between encoder and link: the torque holds the link on one side of it
    link_extra : (4 N,) added to the link parameters
    load_extra : (n, 4) added to the load's [m, hx, hy, hz] visit by visit
    moment_factor : (n, 3) added to the load's first moment, in units of the load's mass [m]
    passive_nm : (n, N) torque exerted on the joints
    gain : (n, N) reported torque over true torque
    offset_nm : (n, N) added to the reading
    coupling : (N, N) reported axis i shows sum_j coupling[i, j] * axis j
    load_friction : (N,) nu of nu |tau|
    one_efficiency : (N,) 1: losses of one efficiency in both directions; 0: symmetric losses
    bias_nm : (N,) half the difference of upward and downward friction
    bias_share : (N,) the part of it that is proportional to the friction of each visit
    band_gain : (n, N) factor on the friction band
    gain_per_nm : (N,) added to the gain per Nm of motor torque
    pull_n : (N, 3) force in the base frame on the origin of each link
    knees : of each bent conversion: axis (from 0), motor torque of the knee [Nm], change of the gain beyond it
    hoses : of each hose: link (from 0); stiffness [N/m], anchor (3) in the base frame and free length [m]
    slosh : of each liquid: steepness; displacement (3,) of the load's centre [m] by the direction of gravity
    """

    tilt_rad: Floats
    zero_offset_rad: Floats
    compliance_rad_nm: Floats
    play_rad: Floats
    link_extra: Floats
    load_extra: Floats
    moment_factor: Floats
    passive_nm: Floats
    gain: Floats
    offset_nm: Floats
    coupling: Floats
    load_friction: Floats
    one_efficiency: Floats
    bias_nm: Floats
    bias_share: Floats
    band_gain: Floats
    gain_per_nm: Floats
    pull_n: Floats
    knees: tuple[tuple[int, Floats | float, Floats | float], ...] = ()
    hoses: tuple[tuple[int, Floats], ...] = ()
    slosh: tuple[tuple[float, Floats], ...] = ()


def neutral(n: int, axes: int) -> AlteredModel:
    """Return the model of `n` visits without effects: rigid links, a rigid load and a constant friction band."""
    none = np.zeros(axes)
    return AlteredModel(
        tilt_rad=np.zeros(2),
        zero_offset_rad=none,
        compliance_rad_nm=none,
        play_rad=none,
        link_extra=np.zeros(4 * axes),
        load_extra=np.zeros((n, 4)),
        moment_factor=np.zeros((n, 3)),
        passive_nm=np.zeros((n, axes)),
        gain=np.ones((n, axes)),
        offset_nm=np.zeros((n, axes)),
        coupling=np.eye(axes),
        load_friction=none,
        one_efficiency=none,
        bias_nm=none,
        bias_share=none,
        band_gain=np.ones((n, axes)),
        gain_per_nm=none,
        pull_n=np.zeros((axes, 3)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Modelled readings (n, N): half-sums, half-differences (0 if one-sided), and torque behind the gears."""

    sum_nm: Floats
    difference_nm: Floats
    joint_nm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Bent:
    """Elastic gears in equilibrium: torque (n, N) and compliance factor `matrix` (n, N, N).

    `rows` (n, N, 4 N) are the gravity rows at nearby angles, with derivatives (n, N, N, 4 N); `away` (n, N) is the
    distance from these angles.
    """

    torque: Floats
    matrix: Floats
    rows: Floats
    slopes: Floats
    away: Floats


def saturating(share: Floats, steepness: float) -> Floats:
    """Return a share of -1 .. 1 that saturates with the steepness; 0 = in proportion."""
    return np.tanh(steepness * share) if steepness > 0.0 else share


class Model:
    """Model of one robot at fixed visits; regressors of the same geometry are computed once.

    Parameters
    ----------
    robot : Robot
    rows : Visits
    gravity_m_s2 : array of shape (3,)
    """

    def __init__(self, robot: Robot, rows: Visits, gravity_m_s2: Floats) -> None:
        self.robot, self.rows, self.gravity = robot, rows, np.asarray(gravity_m_s2, dtype=float)
        self.nominal = gravity_regressor(robot, rows.q_rad, self.gravity)
        self.lossless = bool((rows.gears.efficiency == 1.0).all())
        self._geometry: tuple[bytes, Floats] | None = None
        self._down: Floats | None = None
        self._origins: Floats | None = None
        self._levers: Floats | None = None
        self._bent: tuple[Floats, Floats, Floats] | None = None

    def regressor(self, setting: AlteredModel) -> Floats:
        """Return gravity rows (n, N, 4 N) at the true joint angles and the true gravity, with stiff gears."""
        if not (setting.tilt_rad.any() or setting.zero_offset_rad.any()):
            return self.nominal
        q = self.rows.q_rad + setting.zero_offset_rad
        return self._rows_at(q, setting.tilt_rad)

    def _rows_at(self, q: Floats, tilt_rad: Floats) -> Floats:
        key = q.tobytes() + tilt_rad.tobytes()
        if self._geometry is None or self._geometry[0] != key:
            gravity = rotation(np.append(tilt_rad, 0.0)).T @ self.gravity
            self._geometry = key, gravity_regressor(self.robot, q, gravity)
        return self._geometry[1]

    def bodies(self, setting: AlteredModel, links: Floats, load: Floats) -> Floats:
        """Return the parameters (n, 4 N) of the links with the load on the last link, for each visit."""
        carried = load + setting.load_extra
        moved = setting.moment_factor
        for steepness, path_m in setting.slosh:
            moved = moved + saturating(self.down, steepness) * path_m
        carried[:, 1:] += carried[:, :1] * moved
        bodies = np.repeat((links + setting.link_extra)[None], len(load), axis=0)
        bodies[:, -4:] += carried
        return bodies

    def joint_torque(self, setting: AlteredModel, bodies: Floats) -> tuple[Floats, Floats]:
        """Return the torque (n, N) that the gears transmit, and its derivative (n, N, 4 N) by body parameters."""
        setting = self._without_play(setting, bodies)
        if not setting.compliance_rad_nm.any():
            rows = self.regressor(setting)
            return _dot(rows, bodies) - self.passive(setting), rows
        bent = self._wound_up(setting, bodies)
        rows = bent.rows + np.einsum("nijk,nj->nik", bent.slopes, bent.away)
        return bent.torque, np.linalg.solve(bent.matrix, rows)

    def _without_play(self, setting: AlteredModel, bodies: Floats) -> AlteredModel:
        """Return the setting with the zeros (n, N) of each visit on the flank that its torque holds."""
        if not setting.play_rad.any():
            return setting
        rigid = replace(setting, play_rad=np.zeros_like(setting.play_rad))
        flank = np.sign(self.joint_torque(rigid, bodies)[0])
        return replace(rigid, zero_offset_rad=setting.zero_offset_rad - 0.5 * setting.play_rad * flank)

    def passive(self, setting: AlteredModel) -> Floats:
        """Return the torque (n, N) of springs, cables and pulls on the joints."""
        passive = setting.passive_nm
        if setting.pull_n.any():
            passive = passive + np.einsum("nijk,jk->ni", self.levers, setting.pull_n)
        for link, (stiffness, *anchor, free) in setting.hoses:
            towards = np.array(anchor) - self.origins[:, link]
            length = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
            force = (stiffness * np.maximum(length - free, 0.0) / length)[:, None] * towards
            passive = passive + np.einsum("nik,nk->ni", self.levers[:, :, link], force)
        return passive

    @property
    def origins(self) -> Floats:
        """Return the origin (n, N, 3) of every link in the base frame at the measured angles."""
        if self._origins is None:
            self._origins = link_frames(self.robot, self.rows.q_rad)[:, :, :3, 3]
        return self._origins

    @property
    def down(self) -> Floats:
        """Return the direction (n, 3) of gravity in the last link."""
        if self._down is None:
            self._down = gravity_in_last_link(self.robot, self.rows.q_rad, self.gravity)
        return self._down

    @property
    def levers(self) -> Floats:
        """Return the torque (n, N, N, 3) on axis i of a unit force at the origin of link j."""
        if self._levers is None:
            directions, origins = joint_axes_origins(self.robot, self.rows.q_rad)
            count = self.rows.axes
            levers = np.zeros((len(self.rows), count, count, 3))
            for axis in range(count):
                for link in range(axis, count):
                    levers[:, axis, link] = np.cross(directions[:, axis], origins[:, link] - origins[:, axis])
            self._levers = levers
        return self._levers

    def _wound_up(self, setting: AlteredModel, bodies: Floats) -> _Bent:
        """Return the equilibrium of elastic gears: `tau = tau(bent) + K (q - compliance tau - bent)`."""
        straight = self.rows.q_rad + setting.zero_offset_rad
        steps = 0
        while True:
            if self._bent is None:
                self._bend(straight)
            bent, at_bent, slopes = self._bent  # type: ignore[misc]
            if setting.tilt_rad.any():
                at_bent = self._rows_at(bent, setting.tilt_rad)
            stiffness = np.matmul(slopes.reshape(len(bent), -1, bodies.shape[1]), bodies[:, :, None])
            stiffness = stiffness.reshape(slopes.shape[:3])
            torque = _dot(at_bent, bodies) - self.passive(setting)
            torque = torque + _dot(stiffness, straight - bent)
            matrix = np.eye(self.rows.axes) + stiffness * setting.compliance_rad_nm
            torque = np.linalg.solve(matrix, torque[:, :, None])[:, :, 0]
            away = straight - setting.compliance_rad_nm * torque - bent
            steps += 1
            if np.abs(away).max() < _NEAR_RAD or steps == _WIND_UP_STEPS:
                return _Bent(torque, matrix, at_bent, slopes, away)
            self._bend(bent + away)

    def _bend(self, q: Floats) -> None:
        """Return rows (n, N, 4 N) and derivatives (n, N, N, 4 N) at the deflected joint angles, from a cache."""
        q = np.clip(q, self.rows.q_rad - 1.0, self.rows.q_rad + 1.0)
        count = self.rows.axes
        steps = _SLOPE_STEP_RAD * np.eye(count)
        around = np.concatenate([q[None], q + steps[:, None], q - steps[:, None]])
        rows = gravity_regressor(self.robot, around.reshape(-1, count), self.gravity)
        rows = rows.reshape(2 * count + 1, len(q), count, 4 * count)
        slopes = (rows[1 : count + 1] - rows[count + 1 :]) / (2.0 * _SLOPE_STEP_RAD)
        self._bent = q, rows[0], np.ascontiguousarray(slopes.transpose(1, 2, 0, 3))

    def predict(self, setting: AlteredModel, links: Floats, load: Floats, band_nm: Floats) -> Prediction:
        """Return the modelled readings.

        Parameters
        ----------
        setting : AlteredModel
        links : array of shape (4 N,), [m, hx, hy, hz] per link
        load : array of shape (n, 4), the load's [m, hx, hy, hz] at each visit
        band_nm : array of shape (N,), mean friction against the direction of approach
        """
        return self.readings(setting, self._transmitted(setting, links, load), band_nm)

    def predict_each(
        self, settings: Sequence[AlteredModel], links: Floats, load: Floats, band_nm: Floats
    ) -> Prediction:
        """Return the modelled readings (settings, n, N) of several settings; the other parameters as of `predict`."""
        torque = np.stack([self._transmitted(setting, links, load) for setting in settings])
        return self.readings(together(settings), torque, band_nm)

    def _transmitted(self, setting: AlteredModel, links: Floats, load: Floats) -> Floats:
        """Return the torque (n, N) that the gears transmit."""
        bodies = self.bodies(setting, links, load)
        if setting.compliance_rad_nm.any():
            return self._wound_up(self._without_play(setting, bodies), bodies).torque
        return self.joint_torque(setting, bodies)[0]

    def readings(self, setting: AlteredModel, torque: Floats, band_nm: Floats) -> Prediction:
        """Return the readings (..., n, N) for the torque (..., n, N) that the gears transmit.

        Torque, band and the nuisance parameters of the setting may have leading axes: several models at once.
        """
        two = self.rows.two_sided[:, None]
        band = band_nm * setting.band_gain
        friction = band + setting.load_friction * np.abs(torque) + self._lost_in_gear(setting, torque, band)
        # losses of an efficiency differ by direction already
        uneven = setting.bias_share * (band + _symmetric_loss(setting) * np.abs(torque))
        carried, torque = torque, torque + setting.bias_nm + uneven + self._left_by_gear(setting, torque, band)
        if self._straight(setting):
            # the gear and its conversion cancel: each side reads torque and friction as they are
            middle = (setting.gain * torque + setting.offset_nm) @ np.swapaxes(setting.coupling, -1, -2)
            half = (setting.gain * friction) @ np.swapaxes(setting.coupling, -1, -2)
            up, down = middle + half, middle - half
        else:
            up = self._side(setting, torque, friction, 1.0)
            down = self._side(setting, torque, friction, -1.0)
        half_sum = (up + down) / 2.0
        if self.rows.side.any():
            half_sum = np.where(self.rows.side > 0, up, np.where(self.rows.side < 0, down, half_sum))
        return Prediction(half_sum, np.where(two, (up - down) / 2.0, 0.0), carried)

    def _left_by_gear(self, setting: AlteredModel, torque: Floats, band: Floats) -> Floats:
        """Return the contribution (n, N) of direction-dependent gear losses to the half-sum.

        The motor torque is `(tau + band) / eta` upwards and `(tau - band) eta` downwards if it lifts. With `nu = (1 /
        eta - eta) / 2`, the half-sum exceeds `tau` by `(sqrt(1 + nu^2) - 1) tau + nu band`. If the torque is within the
        band the motor lifts in both directions, and `nu tau` replaces `nu band`.
        """
        nu = setting.load_friction
        within = np.clip(torque, -np.abs(band), np.abs(band))
        return setting.one_efficiency * (_mean_loss(nu) * torque + nu * within)

    def _lost_in_gear(self, setting: AlteredModel, torque: Floats, band: Floats) -> Floats:
        """Return the contribution (n, N) of the gear to the half-difference beyond `band + nu |tau|`."""
        nu = setting.load_friction
        below = np.maximum(np.abs(band) - np.abs(torque), 0.0)
        return setting.one_efficiency * (_mean_loss(nu) * band + nu * below)

    def _straight(self, setting: AlteredModel) -> bool:
        """Return True if the conversion cancels all effects between gear and reading."""
        if setting.gain_per_nm.any() or setting.knees:
            return False
        return self.lossless or not (setting.offset_nm.any() or np.any(setting.coupling != np.eye(self.rows.axes)))

    def mixes(self, setting: AlteredModel) -> bool:
        """Return whether the reading of an axis depends on the torque of another one, so that axes move one by one."""
        geared = self.rows.gears.coupling is not None and not self._straight(setting)
        return geared or bool(np.any(setting.coupling != np.eye(self.rows.axes)))

    def _side(self, setting: AlteredModel, torque: Floats, friction: Floats, direction: float) -> Floats:
        gears = self.rows.gears
        motor = gears.before(torque + direction * friction, direction)
        gain = setting.gain
        if setting.gain_per_nm.any():
            gain = gain + setting.gain_per_nm * np.abs(motor)
        read = gain * motor + setting.offset_nm
        for axis, knee_nm, more in setting.knees:
            beyond = np.maximum(np.abs(motor[..., axis]) - knee_nm, 0.0)
            read[..., axis] += more * beyond * np.sign(motor[..., axis])
        seen = read @ np.swapaxes(setting.coupling, -1, -2)
        return gears.behind(seen, direction)

    def sum_by_torque(self, setting: AlteredModel, torque: Floats, band_nm: Floats) -> Floats:
        """Return the derivative (n, N, N) of the half-sums with respect to the transmitted torque of each axis."""
        if self._straight(setting) and not self.rows.side.any():
            nu, within = setting.load_friction, np.abs(torque) < np.abs(band_nm * setting.band_gain)
            left = 1.0 + setting.one_efficiency * (_mean_loss(nu) + nu * within)
            left = left + setting.bias_share * _symmetric_loss(setting) * np.sign(torque)
            return setting.coupling[None] * (setting.gain * left)[:, None, :]
        step = 1e-4 * (1.0 + np.abs(torque).max(axis=0))
        shifts = np.diag(step) if self.mixes(setting) else step[None]
        above, below = self.readings(setting, torque + np.stack([shifts, -shifts])[:, :, None], band_nm).sum_nm
        slopes = (above - below).transpose(1, 2, 0) / 2.0
        return slopes / step if len(shifts) == len(step) else slopes * np.diag(1.0 / step)


def together(settings: Sequence[AlteredModel]) -> AlteredModel:
    """Return several settings as one for `readings`: fields in which they differ, and knees, have a leading axis."""
    first, stacked = settings[0], {}
    for field in fields(first):
        values = [getattr(setting, field.name) for setting in settings]
        if isinstance(values[0], np.ndarray) and any(value is not values[0] for value in values):
            stacked[field.name] = np.stack(values).reshape(len(values), -1, values[0].shape[-1])
    knees = [
        (bends[0][0], *np.array([bend[1:] for bend in bends]).T[:, :, None])
        for bends in zip(*(setting.knees for setting in settings), strict=True)
    ]
    return replace(first, knees=tuple(knees), **stacked)


def _symmetric_loss(setting: AlteredModel) -> Floats:
    """Return the part (N,) of the loss per transmitted torque that is equal in driving and back-driving."""
    return (1.0 - setting.one_efficiency) * setting.load_friction


def _mean_loss(nu: Floats) -> Floats:
    """Return the excess over 1 of the mean of an efficiency and its inverse."""
    return np.sqrt(1.0 + nu**2) - 1.0


def rotation(vector_rad: Floats) -> Floats:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) (Rodrigues)."""
    angle = float(np.linalg.norm(vector_rad))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _dot(rows: Floats, bodies: Floats) -> Floats:
    return np.matmul(rows, bodies[:, :, None])[:, :, 0]
