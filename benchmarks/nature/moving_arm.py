"""A moving arm: parameters identifiable in motion only, with a load that has inertia."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.drawn_arm import arm_geometry, rated_torque_nm
from benchmarks.nature.gear_friction import Friction, draw_friction
from benchmarks.nature.levels import Harshness
from sim.draw import GRAVITY, draw_load
from sim.plant import Payload
from sim.urdf import SimBody, SimChain, combine, write_chain

Array = NDArray[np.float64]

SHORTEST_LINK_M = 0.1
MOST_SIGMAS = 2.5
#: Torque for a moment, over the rated one.
PEAK = 2.0
#: Speed limits of the axes of an arm of 165 kg [rad/s]; the last applies to further axes.
SPEEDS_RAD_S = (2.0, 1.9, 2.0, 3.2, 3.2, 4.5)
#: Share of the axes whose friction falls when they start to move.
STRIBECK_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class MovingArm:
    """One real arm; arrays (N,) unless stated otherwise, all at the gear output.

    Attributes
    ----------
    chain : geometry, limits and true inertials
    tool : load on the last link in the loaded runs
    rated_nm : rated torque
    gain, gain_std : relative error of the torque constants, and what it was drawn with
    friction : Coulomb friction, losses with load, bias by direction, warm-up, scatter from stroke to stroke
    viscous_nm_s_rad : warm
    breakaway_share, stribeck_rad_s, stribeck_power : breakaway friction over Coulomb, less 1; it fades with
        `exp(-(|qd| / stribeck) ** power)`
    rotor_inertia_kg_m2 : reflected
    cogging_nm : (N, 4) sine and cosine of once and twice the motor's turn
    cogging_std_nm : standard deviation of each of these amplitudes
    gear_ratio : motor turns of one turn
    filter_s, dead_s : first-order lag, and pure delay, of the torque that is reported
    noise_nm, noise_s, white_share : of one reading: size, correlation time, share of the variance that is white
    resolution_nm, count_rad : least significant bits of torque and position
    gravity_m_s2 : (3,)
    """

    chain: SimChain
    tool: Payload
    rated_nm: Array
    gain: Array
    gain_std: Array
    friction: Friction
    viscous_nm_s_rad: Array
    breakaway_share: Array
    stribeck_rad_s: Array
    stribeck_power: Array
    rotor_inertia_kg_m2: Array
    cogging_nm: Array
    cogging_std_nm: Array
    gear_ratio: Array
    filter_s: Array
    dead_s: Array
    noise_nm: Array
    noise_s: Array
    white_share: float
    resolution_nm: Array
    count_rad: Array
    gravity_m_s2: Array

    @property
    def delay_s(self) -> Array:
        """By how much (N,) the reported torque lags behind the motion, where it changes slowly."""
        return self.filter_s + self.dead_s

    def carrying(self, loaded: str) -> SimChain:
        """Return the chain with its load: the tool, or nothing under the label `none`."""
        if loaded == "none":
            return self.chain
        tool = SimBody(self.tool.mass_kg, self.tool.com_m, self.tool.inertia_kg_m2)
        last = self.chain.bodies[-1]
        joined = tool if last is None else combine(last, tool)
        return replace(self.chain, bodies=(*self.chain.bodies[:-1], joined))


@dataclass(frozen=True, slots=True)
class StatedMoving:
    """Statements of the owner.

    CAD's URDF with its trust, standard deviations (N,) of the torque constants, efficiencies (N,) of the gears.
    """

    urdf: str
    link_std: float
    gain_std: Array
    efficiency: Array


def draw_moving_arm(levels: Harshness, rng: np.random.Generator) -> tuple[MovingArm, StatedMoving]:
    """Draw an arm of six axes and what is stated of it; everything random comes from `rng`."""
    payload_kg = float(np.exp(rng.uniform(np.log(8.0), np.log(250.0))))
    return moving_arm(arm_geometry(payload_kg, rng), payload_kg, levels, rng)


def moving_arm(
    cad: SimChain, payload_kg: float, levels: Harshness, rng: np.random.Generator
) -> tuple[MovingArm, StatedMoving]:
    """The same of a chain of any number of axes, whose inertials are the CAD's, for loads up to `payload_kg`."""
    axes = len(cad.axis)
    tool = draw_load("tool", payload_kg, rng)
    tool = replace(tool, inertia_kg_m2=box_inertia(tool.mass_kg, 1.2 * (payload_kg / 165.0) ** 0.3, rng))
    link_std = float(rng.uniform(*levels.cad_std))
    true = replace(cad, bodies=tuple(_as_built(cad, link, link_std, rng) for link in range(axes)))
    bodies = [body for body in true.bodies if body is not None]
    rated = rated_torque_nm(
        true, np.array([body.mass_kg for body in bodies]), np.array([body.com_m for body in bodies]), tool, rng
    )
    gain_std = rng.uniform(*levels.gain_std) * rng.uniform(0.8, 1.25, axes)
    friction = draw_friction(rated, levels, rng)
    size = np.array([SPEEDS_RAD_S[min(axis, 5)] for axis in range(axes)])
    speed = size * (payload_kg / 165.0) ** -0.2 * rng.uniform(0.8, 1.2, axes)
    noise = rated * rng.uniform(0.002, 0.012, axes)
    cogging_std = rng.uniform(*levels.cogging_ratio, axes) * 0.1 * friction.coulomb_nm
    gear_ratio = np.round(rng.uniform(50.0, 200.0, axes))
    limits = {"velocity_rad_s": speed, "effort_nm": PEAK * rated}
    arm = MovingArm(
        chain=replace(true, **limits),
        tool=tool,
        rated_nm=rated,
        gain=gain_std * rng.standard_normal(axes),
        gain_std=gain_std,
        friction=friction,
        viscous_nm_s_rad=friction.coulomb_nm * rng.uniform(0.3, 1.2, axes) / speed,
        breakaway_share=rng.uniform(0.05, 0.4, axes) * (rng.random(axes) < STRIBECK_SHARE),
        stribeck_rad_s=speed * rng.uniform(0.005, 0.03, axes),
        stribeck_power=rng.uniform(1.0, 2.0, axes),
        rotor_inertia_kg_m2=rated / rng.uniform(40.0, 120.0, axes),
        cogging_nm=cogging_std[:, None] * rng.standard_normal((axes, 4)),
        cogging_std_nm=cogging_std,
        gear_ratio=gear_ratio,
        filter_s=rng.uniform(0.0005, 0.006, axes),
        dead_s=rng.uniform(0.0, 0.004, axes),
        noise_nm=noise,
        noise_s=rng.uniform(0.002, 0.03, axes),
        white_share=float(rng.uniform(0.1, 0.5)),
        resolution_nm=rated * rng.uniform(0.0002, 0.001, axes),
        count_rad=2.0 * np.pi / (2.0 ** rng.integers(13, 18, axes) * gear_ratio),
        gravity_m_s2=GRAVITY,
    )
    urdf = write_chain(replace(cad, name="cad", **limits))
    return arm, StatedMoving(urdf, link_std, gain_std, friction.declared_efficiency)


def box_inertia(mass_kg: float, largest_m: float, rng: np.random.Generator) -> Array:
    """Inertia (3, 3) about its centre of a box, turned by chance, with edges of a twentieth of `largest_m` to all."""
    edges = largest_m * rng.uniform(0.05, 1.0, 3)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return turn @ np.diag(mass_kg / 12.0 * (edges @ edges - edges**2)) @ turn.T


def _as_built(cad: SimChain, link: int, trust: float, rng: np.random.Generator) -> SimBody:
    """A link as it is: mass, place and inertia off the CAD's by a trust as `prior:S` has it."""
    body = cad.bodies[link]
    if body is None:
        raise ValueError(f"link_{link + 1} has no inertial")
    onward = float(np.linalg.norm(cad.placement[min(link + 1, len(cad.axis) - 1), :3, 3]))
    length = max(onward, float(np.linalg.norm(body.com_m)), SHORTEST_LINK_M)
    off = trust * np.clip(rng.standard_normal(5), -MOST_SIGMAS, MOST_SIGMAS)
    return SimBody(body.mass_kg * (1.0 + off[0]), body.com_m + length * off[1:4], body.inertia_kg_m2 * (1.0 + off[4]))
