"""Measured tables straight from the physics of a plant, without bus, drives or time steps.

At rest the torque that a gear transmits follows from static equilibrium; the motor torque differs from it by friction,
which is a set: after a slow approach in direction d friction is anywhere between its kinetic level and the remainder
once the controller has settled. Every pose is approached from both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.plant import Payload, Plant
from sim.urdf import SimChain

Array = NDArray[np.float64]
_ELASTIC_STEPS = 12


@dataclass(frozen=True, slots=True)
class PlannedVisit:
    """Rest pose to be approached from both directions.

    Attributes
    ----------
    pose : number of the pose
    load : label of the mounted load
    time_s : start of the visit
    q_rad : (N,) joint angles as the encoders give them
    """

    pose: int
    load: str
    time_s: float
    q_rad: Array


@dataclass(frozen=True, slots=True)
class Protocol:
    """Measurement procedure of a pose visit.

    Attributes
    ----------
    samples : readings averaged per side
    settle : (N,) or (1,) share of the friction band that may be lost while the joint settles: what is left after
        the approach is `band * (1 - settle * u)`, `u` uniform on [0, 1], of each side its own; with 1 the standard
        deviation of half the sum of both sides is 20 % of the band
    resolution_nm : (N,) or (1,) least significant bit of the reading, joint side
    side_time_s : time between the two sides of one visit
    band_factor : q_rad (N,) -> (N,) factor on the friction band by position; None = the same everywhere
    secondary_encoder : whether the link side angle is reported
    """

    samples: int = 100
    settle: Array = field(default_factory=lambda: np.full(1, 0.4))
    resolution_nm: Array = field(default_factory=lambda: np.zeros(1))
    side_time_s: float = 8.0
    band_factor: Callable[[Array], Array] | None = None
    secondary_encoder: bool = False


def link_frames(chain: SimChain, q_rad: Array) -> Array:
    """Pose (n, N, 4, 4) of every link frame in the base for joint angles (n, N); Rodrigues' formula."""
    q_rad = np.atleast_2d(q_rad)
    frames = np.empty((*q_rad.shape, 4, 4))
    pose = np.broadcast_to(np.eye(4), (len(q_rad), 4, 4))
    for joint in range(len(chain.axis)):
        x, y, z = chain.axis[joint]
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.broadcast_to(np.eye(4), (len(q_rad), 4, 4)).copy()
        sine, versine = np.sin(q_rad[:, joint]), 1.0 - np.cos(q_rad[:, joint])
        turn[:, :3, :3] += sine[:, None, None] * cross + versine[:, None, None] * (cross @ cross)
        pose = pose @ chain.placement[joint] @ turn
        frames[:, joint] = pose
    return frames


def statics(chain: SimChain, plant: Plant, q_rad: Array) -> Array:
    """Torque (n, N) [Nm] that the actuators must give against gravity at true joint angles (n, N)."""
    parameters = np.column_stack([plant.link_mass_kg, plant.link_mass_kg[:, None] * plant.link_com_m])
    load = plant.payload
    parameters[-1] += load.mass_kg * np.append(1.0, load.com_m)
    return gravity_columns(chain, q_rad, plant.gravity_m_s2) @ parameters.ravel()


def point_jacobian(chain: SimChain) -> Callable[[Array, int, Array], tuple[Array, Array]]:
    """Position (3,) and translational Jacobian (3, N) of a point of a link (from 0), in the base frame."""

    def jacobian(q_rad: Array, link: int, point_m: Array) -> tuple[Array, Array]:
        frames = link_frames(chain, q_rad)[0]
        position = frames[link, :3, :3] @ point_m + frames[link, :3, 3]
        columns = np.zeros((3, len(chain.axis)))
        for joint in range(link + 1):
            axis = frames[joint, :3, :3] @ chain.axis[joint]
            columns[:, joint] = np.cross(axis, position - frames[joint, :3, 3])
        return position, columns

    return jacobian


def gravity_columns(chain: SimChain, q_rad: Array, gravity_m_s2: Array) -> Array:
    """Torque (n, N, 4 N) per unit of [m, hx, hy, hz] of each link at true joint angles (n, N).

    `tau_i = - z_i . sum_k (p_k - o_i) x m_k g` over the masses that axis i carries.
    """
    frames = link_frames(chain, q_rad)
    axes = np.einsum("njab,jb->nja", frames[:, :, :3, :3], chain.axis)
    count = len(chain.axis)
    columns = np.zeros((len(frames), count, 4 * count))
    for joint in range(count):
        push = np.cross(gravity_m_s2, axes[:, joint])
        for link in range(joint, count):
            arm = frames[:, link, :3, 3] - frames[:, joint, :3, 3]
            columns[:, joint, 4 * link] = -np.einsum("na,na->n", push, arm)
            columns[:, joint, 4 * link + 1 : 4 * link + 4] = -np.einsum("na,nab->nb", push, frames[:, link, :3, :3])
    return columns


def transmitted(chain: SimChain, plant: Plant, q_enc_rad: Array, time_s: float) -> tuple[Array, Array]:
    """Torque the gears transmit (N,) and true joint angles (N,) in equilibrium, gears wound up under that torque."""
    tau = np.zeros(plant.axes)
    q = np.asarray(q_enc_rad, dtype=float)
    for _ in range(_ELASTIC_STEPS if np.any(plant.compliance_rad_nm) else 2):
        q = q_enc_rad + plant.zero_offset_rad - plant.compliance_rad_nm * tau
        tau = statics(chain, plant, q[None])[0]
        if plant.passive_torque is not None:
            tau = tau - plant.passive_torque(q, time_s, tau)
    return tau, q


def reading(plant: Plant, q_enc_rad: Array, motor_nm: Array) -> Array:
    """Return what the drives report (N,) of the true motor torques (N,), both joint side; no noise."""
    seen = plant.current_factor * motor_nm / plant.torque_constant_scale + plant.reading_offset_nm
    if plant.reading_ripple is not None:
        seen = seen + plant.reading_ripple(q_enc_rad, motor_nm)
    return (plant.torque_sign * (plant.coupling @ seen))[plant.drive_joint]


def motor_torque(plant: Plant, behind_gear_nm: Array, direction: float) -> Array:
    """Joint-side motor torque (N,) after motion in `direction`: driving `T = eta u`, driven back `T = u / eta`."""
    driving = behind_gear_nm * direction > 0
    return np.where(driving, behind_gear_nm / plant.gear_efficiency, behind_gear_nm * plant.gear_efficiency)


def measure(
    chain: SimChain,
    plant: Plant,
    visits: Sequence[PlannedVisit],
    loads: Mapping[str, Payload],
    protocol: Protocol,
    rng: np.random.Generator,
) -> dict[str, NDArray[Any]]:
    """Rows of a measured table: each visit from above and from below.

    Parameters
    ----------
    chain : geometry of the arm
    plant : its true physics
    visits : rest poses with load and time
    loads : payload by label; `none` may be left out
    protocol : samples, settling, resolution
    rng : source of friction states and sample noise

    Returns
    -------
    columns by name, as in the measured table: `load` (str), `pose`, `time_s` and `n` of shape (2 * visits,); `q_rad`,
    `dir`, `tau_nm`, `tau_std_nm`, `temp_c` (NaN if not reported) and `q2nd_rad` (likewise) of shape (2 * visits, N)
    """
    rows: dict[str, list[Any]] = {name: [] for name in ("load", "pose", "time_s", "n")}
    by_axis: dict[str, list[Any]] = {
        name: [] for name in ("q_rad", "dir", "tau_nm", "tau_std_nm", "temp_c", "q2nd_rad")
    }
    axes = plant.axes
    unknown = np.full(axes, np.nan)
    swap = plant.drive_joint
    for visit in visits:
        payload = loads.get(visit.load, Payload())
        for side, direction in enumerate((1.0, -1.0)):
            now_s = visit.time_s + side * protocol.side_time_s
            state = plant.with_payload(payload).at(now_s)
            actual = np.asarray(visit.q_rad)[np.argsort(swap)]
            tau, q_true = transmitted(chain, state, actual, now_s)
            factor = 1.0 if protocol.band_factor is None else protocol.band_factor(actual)
            band = state.coulomb_nm * factor + state.load_friction * np.abs(tau)
            left = 1.0 - protocol.settle * rng.uniform(size=axes)
            behind = tau + direction * band * left + state.friction_bias_nm
            seen = reading(state, actual, motor_torque(state, behind, direction))
            noise = state.reading_noise_nm[swap]
            freedom = max(protocol.samples - 1, 1)
            spread = noise * np.sqrt(rng.chisquare(freedom, size=axes) / freedom)
            mean = _quantised(seen, noise, protocol, rng)
            rows["load"].append(visit.load)
            rows["pose"].append(visit.pose)
            rows["time_s"].append(now_s)
            rows["n"].append(protocol.samples)
            by_axis["q_rad"].append(np.asarray(visit.q_rad, dtype=float))
            by_axis["dir"].append(np.full(axes, direction))
            by_axis["tau_nm"].append(mean)
            by_axis["tau_std_nm"].append(np.hypot(spread, protocol.resolution_nm / np.sqrt(12.0)))
            temperature = state.temperature_c
            by_axis["temp_c"].append(unknown if temperature is None else np.asarray(temperature(now_s)))
            by_axis["q2nd_rad"].append(q_true - state.zero_offset_rad if protocol.secondary_encoder else unknown)
    columns: dict[str, NDArray[Any]] = {name: np.array(values) for name, values in rows.items()}
    return columns | {name: np.array(values, dtype=float).reshape(-1, axes) for name, values in by_axis.items()}


def _quantised(seen_nm: Array, noise_nm: Array, protocol: Protocol, rng: np.random.Generator) -> Array:
    """Mean of noisy readings that the drive rounds to its resolution; the noise dithers the rounding."""
    mean = seen_nm + noise_nm / np.sqrt(protocol.samples) * rng.standard_normal(len(seen_nm))
    lsb = protocol.resolution_nm
    safe = np.where(lsb > 0, lsb, 1.0)
    # a reading whose noise exceeds half a step averages to its own value, a quiet one to the nearest step
    stuck = np.round(seen_nm / safe) * safe
    share = np.exp(-2.0 * (np.pi * noise_nm / safe) ** 2)
    return np.where(lsb > 0, mean + share * (stuck - seen_nm), mean)


def half_floor(plant: Plant, protocol: Protocol) -> Array:
    """Standard deviation (N,) [Nm] of half the sum of both sides: asymmetry that is left, noise, resolution."""
    left = plant.coulomb_nm * protocol.settle / np.sqrt(12.0)
    noise = plant.reading_noise_nm**2 / protocol.samples
    return np.sqrt((left**2 + noise) / 2.0)
