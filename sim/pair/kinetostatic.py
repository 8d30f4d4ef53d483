"""Two arms and a part without mass forces: commands of both arms in, true poses and the force between them out.

Servos are first-order lags behind a bus cycle, gears have play and a cyclic error, and every mismatch between the
grippers becomes force through the chain of gears and part, `K_tot = (K_w^-1 + J1 Kg^-1 J1^T + J2 Kg^-1 J2^T)^-1` about
fingertip 2. Drives report torque with noise, and the controller's model of gravity and friction is wrong; what arrives
is therefore a filtered wrench with a bias that depends on posture and direction. All runs of a batch advance together;
a batch shares the path, not the errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.pair.errors import COULOMB_SHARE, RATED_TORQUE_NM, VISCOUS_AT_RAD_S, VISCOUS_SHARE, ArmErrors, PairErrors
from sim.pair.geometry import GRAVITY_M_S2, PART_MASS_KG, ArmGeometry, frames, jacobian, nominal_arms, tip

Array = NDArray[np.float64]

#: Standard workpiece [N/m, Nm/rad].
WORKPIECE = (4e5, 4e3)
FILTER_HZ = 15.0
NOISE_SHARE, QUANTUM_SHARE = 0.003, 0.001
#: Masses of links 1 to 6, gripper and half the part included in the last [kg]; each acts half way along its link.
LINK_MASS_KG = np.array([40.0, 30.0, 20.0, 12.0, 4.0, 8.5])
STILL_RAD_S = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class PathConstants:
    """What a path fixes for all runs: nominal joints (M, 2, 6) of master and slave, and what follows from them.

    Attributes
    ----------
    q_rad, qd_rad_s : arrays of shape (M, 2, 6)
    dt_s : control cycle
    jacobian : array of shape (M, 2, 6, 6), world axes, each at its own fingertip
    lever_m : array of shape (M, 3), from fingertip 1 to fingertip 2
    gravity_nm : array of shape (M, 2, 6), torque that holds the arms
    share_n : array of shape (M, 3), half of the part's weight and inertia reaction
    """

    q_rad: Array
    qd_rad_s: Array
    dt_s: float
    jacobian: Array
    lever_m: Array
    gravity_nm: Array
    share_n: Array


@dataclass(frozen=True, slots=True, eq=False)
class CellReading:
    """One control cycle of all runs.

    `wrench` (n, 2, 6): estimate per arm, base axes [N, Nm]; `encoder_rad` (n, 2, 6); `internal` (n, 6): true internal
    wrench at the part's centre, world axes; `mismatch` (n, 6): of gripper 2 from where the part wants it, world axes.
    """

    wrench: Array
    encoder_rad: Array
    internal: Array
    mismatch: Array


def path_constants(q_rad: Array, dt_s: float) -> PathConstants:
    """Constants of a path from the nominal joint positions (M, 2, 6) [rad] of master and slave."""
    arms = nominal_arms()
    speed = np.gradient(q_rad, dt_s, axis=0)
    both = np.stack([jacobian(arm, q_rad[:, i]) for i, arm in enumerate(arms)], axis=1)
    tips = [tip(arm, q_rad[:, i])[:, :3, 3] for i, arm in enumerate(arms)]
    acceleration = np.gradient(np.gradient(0.5 * (tips[0] + tips[1]), dt_s, axis=0), dt_s, axis=0)
    share = 0.5 * PART_MASS_KG * (np.array([0.0, 0.0, -GRAVITY_M_S2]) - acceleration)
    gravity = np.stack([gravity_torque(arm, q_rad[:, i]) for i, arm in enumerate(arms)], axis=1)
    return PathConstants(q_rad, speed, dt_s, both, tips[1] - tips[0], gravity, share)


def gravity_torque(arm: ArmGeometry, q_rad: Array) -> Array:
    """Torque (M, 6) [Nm] that holds an arm with its links' masses half way along them, world z up."""
    own = frames(arm, q_rad)
    world = arm.base @ np.concatenate([np.broadcast_to(np.eye(4), own[:, :1].shape), own], axis=1)
    centres = 0.5 * (world[:, :-1, :3, 3] + world[:, 1:, :3, 3])
    torque = np.zeros(q_rad.shape)
    for j in range(6):
        axis, origin = world[:, j, :3, 2], world[:, j, :3, 3]
        lever = np.cross(axis[:, None], centres[:, j:] - origin[:, None])
        torque[:, j] = GRAVITY_M_S2 * (lever[..., 2] * LINK_MASS_KG[j:]).sum(axis=1)
    return torque


def chain_stiffness(constants: PathConstants, errors: PairErrors, workpiece: tuple[float, float] = WORKPIECE) -> Array:
    """Stiffness (M, 6, 6) of gears and part between the grippers about fingertip 2, world axes `[N/m; Nm/rad]`."""
    compliance = np.diag(np.repeat([1.0 / workpiece[0], 1.0 / workpiece[1]], 3))[None]
    lever = constants.lever_m
    shift = np.tile(np.eye(6), (len(lever), 1, 1))
    shift[:, 0, 4], shift[:, 0, 5], shift[:, 1, 5] = lever[:, 2], -lever[:, 1], lever[:, 0]
    shift[:, 1, 3], shift[:, 2, 3], shift[:, 2, 4] = -lever[:, 2], lever[:, 1], -lever[:, 0]
    for i, arm in enumerate((errors.master, errors.slave)):
        at_tip = shift @ constants.jacobian[:, i] if i == 0 else constants.jacobian[:, i]
        compliance = compliance + (at_tip / arm.gear_stiffness_nm_rad) @ np.swapaxes(at_tip, 1, 2)
    return np.asarray(np.linalg.inv(compliance), dtype=float)


class KinetostaticPair:
    """A batch of runs of the pair.

    Parameters
    ----------
    constants : PathConstants
    errors : sequence of PairErrors, one per run
    stiffness : array of shape (n, M, 6, 6)
        Chain stiffness of each run.
    """

    def __init__(self, constants: PathConstants, errors: Sequence[PairErrors], stiffness: Sequence[Array]) -> None:
        self._constants, self._stiffness = constants, stiffness
        arms = [[item.master, item.slave] for item in errors]
        self._arms = ArmGeometry(
            *(_stack(arms, name) for name in ("d_m", "a_m", "alpha_rad", "zero_rad", "base", "tool"))
        )
        lag = np.array([[arm.lag_s for arm in pair] for pair in arms])
        self._follow = 1.0 - np.exp(-constants.dt_s / np.maximum(lag, 1e-9))
        self._play = 0.5 * np.array([[arm.backlash_rad for arm in pair] for pair in arms])
        self._cyclic = np.array([[arm.cyclic_rad for arm in pair] for pair in arms])
        self._phase = np.array([[arm.cyclic_phase_rad for arm in pair] for pair in arms])
        self._per_rev = np.array([[arm.cyclic_per_rev for arm in pair] for pair in arms])
        self._late = np.array([item.skew_s for item in errors])[:, None] / constants.dt_s
        self._bases = np.array([[arm.base[:3, :3] for arm in nominal_arms()]])
        self._to_wrench = np.linalg.inv(np.swapaxes(constants.jacobian, 2, 3))
        self._gravity_error = np.array([[arm.gravity_scale - 1.0 for arm in pair] for pair in arms])
        self._friction_error = np.array([[arm.friction_scale - 1.0 for arm in pair] for pair in arms])
        self._share = 1.0 - math.exp(-2.0 * math.pi * FILTER_HZ * constants.dt_s)
        self.grasp = np.tile(np.eye(4), (len(errors), 1, 1))
        self.snag_n = np.zeros((len(errors), 3))

    def delay(self, skew_s: Array) -> None:
        """How much later (n,) [s] than the master's bus the slave's bus has its SYNC from now on."""
        self._late = np.asarray(skew_s, dtype=float)[:, None] / self._constants.dt_s

    def place(self, q_rad: Array) -> None:
        """Stand still at joint positions (n, 2, 6) [rad]; gears in the middle of their play, filters at rest."""
        self._command = [q_rad.copy(), q_rad.copy()]
        self._motor, self._link = q_rad.copy(), q_rad.copy()
        self._filtered: Array | None = None
        self._seen: Array | None = None

    def grip(self) -> None:
        """Close both grippers free of force where they are."""
        first, second = self.tips()
        self.grasp = _inverse(first) @ second

    def tips(self) -> tuple[Array, Array]:
        """True fingertips (n, 4, 4) of both arms, world."""
        both = tip(self._arms, self._link + self._cyclic * np.sin(self._per_rev * self._link + self._phase))
        return both[:, 0], both[:, 1]

    def step(
        self, m: NDArray[np.int64] | int, q_command_rad: Array, noise: Array, friction: float = 1.0
    ) -> CellReading:
        """One control cycle.

        Parameters
        ----------
        m : int or array of shape (n,)
            Index of the command along the path.
        q_command_rad : array of shape (n, 2, 6)
            Commanded now; the servos start on it a cycle later.
        noise : array of shape (n, 2, 6) or (2, 6)
            Torque noise [Nm].
        friction : 1 while moving, 0 where dither at standstill averages friction out.

        Returns
        -------
        CellReading
            The wrench is that of the cycle before: it has to travel the bus.
        """
        target = self._command[1].copy()
        target[:, 1] += self._late * (self._command[0][:, 1] - self._command[1][:, 1])
        self._command = [self._command[1], q_command_rad]
        self._motor += self._follow * (target - self._motor)
        self._link = np.clip(self._link, self._motor - self._play, self._motor + self._play)
        internal, mismatch, true = self._force(m)
        sample = true + self._error(m, noise, friction)
        self._filtered = sample if self._filtered is None else self._filtered + self._share * (sample - self._filtered)
        seen = self._filtered if self._seen is None else self._seen
        self._seen = self._filtered
        return CellReading(seen, self._motor.copy(), internal, mismatch)

    def mismatch(self) -> Array:
        """Gripper 2 (n, 6) [m, rad] from where the part, held by gripper 1, wants it; world axes."""
        first, second = self.tips()
        wanted = first @ self.grasp
        turn = second[:, :3, :3] @ np.swapaxes(wanted[:, :3, :3], 1, 2)
        vector = 0.5 * np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
        )
        sine = np.linalg.norm(vector, axis=1, keepdims=True)
        scale = np.arcsin(np.minimum(sine, 1.0)) / np.where(sine > 0.0, sine, 1.0)
        return np.concatenate([second[:, :3, 3] - wanted[:, :3, 3], vector * np.where(sine > 0.0, scale, 1.0)], axis=1)

    def _force(self, m: NDArray[np.int64] | int) -> tuple[Array, Array, Array]:
        constants = self._constants
        mismatch = self.mismatch()
        index = np.broadcast_to(m, len(mismatch))
        stiffness = np.array([rows[i] for rows, i in zip(self._stiffness, index, strict=True)])
        second = -(stiffness @ mismatch[..., None])[..., 0]
        lever = constants.lever_m[index]
        internal = second.copy()
        internal[:, 3:] += np.cross(0.5 * lever, second[:, :3])
        first = -second
        first[:, 3:] -= np.cross(lever, second[:, :3])
        world = np.stack([first, second], axis=1)
        world[..., :3] += constants.share_n[index][:, None]
        world[:, 1, :3] += self.snag_n
        return (
            internal,
            mismatch,
            np.concatenate([self._to_base(world[..., :3]), self._to_base(world[..., 3:])], axis=-1),
        )

    def _error(self, m: NDArray[np.int64] | int, noise: Array, friction: float) -> Array:
        """What noise and the wrong model add to the wrench (n, 2, 6), base axes."""
        constants = self._constants
        speed = constants.qd_rad_s[m]
        rubbing = RATED_TORQUE_NM * (
            COULOMB_SHARE * np.tanh(speed / STILL_RAD_S) + VISCOUS_SHARE * speed / VISCOUS_AT_RAD_S
        )
        torque = self._gravity_error * constants.gravity_nm[m] + friction * self._friction_error * rubbing + noise
        world = (self._to_wrench[m] @ torque[..., None])[..., 0]
        return np.concatenate([self._to_base(world[..., :3]), self._to_base(world[..., 3:])], axis=-1)

    def _to_base(self, vectors: Array) -> Array:
        return np.einsum("naji,naj->nai", np.broadcast_to(self._bases, (*vectors.shape[:2], 3, 3)), vectors)


def torque_noise(seed: int, cycle: int, count: int) -> Array:
    """Torque noise and quantisation (count, 2, 6) [Nm] of one cycle; the same for every method of a seed."""
    rng = np.random.default_rng([seed, cycle, 0x70])
    white = rng.normal(0.0, NOISE_SHARE, (count, 2, 6))
    return RATED_TORQUE_NM * (white + rng.uniform(-0.5 * QUANTUM_SHARE, 0.5 * QUANTUM_SHARE, (count, 2, 6)))


def _stack(arms: list[list[ArmErrors]], name: str) -> Array:
    return np.array([[getattr(arm.geometry, name) for arm in pair] for pair in arms])


def _inverse(transform: Array) -> Array:
    result = np.zeros_like(transform)
    turned = np.swapaxes(transform[..., :3, :3], -1, -2)
    result[..., :3, :3] = turned
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", turned, transform[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result
