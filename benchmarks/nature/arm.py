"""One real arm, and the statements of its owner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.drawn_arm import arm_geometry, rated_torque_nm
from benchmarks.nature.gear_friction import Friction, draw_friction
from benchmarks.nature.levels import Harshness
from sim.draw import GRAVITY, draw_load
from sim.plant import Payload
from sim.urdf import SimBody, SimChain, write_chain

Array = NDArray[np.float64]

SHORTEST_LINK_M = 0.1
#: Links are drawn wrong by at most so many standard deviations.
MOST_SIGMAS = 2.5


@dataclass(frozen=True, slots=True)
class Stated:
    """Statements of the owner.

    Attributes
    ----------
    urdf : the CAD's arm
    link_std : relative standard deviation of the CAD's inertials, as `prior:S`
    gain_std : (6,) relative standard deviation of the torque constants
    efficiency : (6,) declared gear efficiencies
    gear_ratio : (6,) or None where unknown
    misstated : whether `link_std` and `gain_std` are wrong by a factor of 2
    """

    urdf: str
    link_std: float
    gain_std: Array
    efficiency: Array
    gear_ratio: Array | None
    misstated: bool


@dataclass(frozen=True, slots=True)
class NatureArm:
    """One arm with all nuisance effects.

    Attributes
    ----------
    chain : geometry with the CAD's inertials
    links : (24,) true [m, hx, hy, hz] of every link [kg, kg m]
    links_std : (24,) standard deviation that they differ from the CAD's with
    tool : load on the flange in the loaded visits
    rated_nm : (6,) rated torque
    gain, gain_std : (6,) relative error of the torque constants, and what it was drawn with
    friction : gear losses and their scatter
    cogging_nm : (6, 4) sine and cosine of once and twice the motor's turn
    cogging_std_nm : (6,) standard deviation of each of these amplitudes
    gear_ratio : (6,) true ratio
    repeat_rad : (6,) standard deviation of the link angle from visit to visit
    backlash_rad : (6,) width of the play behind the encoder
    noise_nm, resolution_nm : (6,) of one reading
    samples : readings a side
    floor_nm : (6,) standard deviation of half the sum of both sides: friction, scatter, noise; no cogging, no pose
    gravity_m_s2 : (3,) in the frame of the base
    """

    chain: SimChain
    links: Array
    links_std: Array
    tool: Payload
    rated_nm: Array
    gain: Array
    gain_std: Array
    friction: Friction
    cogging_nm: Array
    cogging_std_nm: Array
    gear_ratio: Array
    repeat_rad: Array
    backlash_rad: Array
    noise_nm: Array
    resolution_nm: Array
    samples: int
    floor_nm: Array
    gravity_m_s2: Array

    @property
    def load(self) -> Array:
        """True [m, hx, hy, hz] of the tool (4,) [kg, kg m] in the frame of the last link."""
        return self.tool.mass_kg * np.append(1.0, self.tool.com_m)


def draw_arm(levels: Harshness, rng: np.random.Generator) -> tuple[NatureArm, Stated]:
    """Draw an arm and what is stated of it; everything random comes from `rng`."""
    payload_kg = float(np.exp(rng.uniform(np.log(8.0), np.log(250.0))))
    chain = arm_geometry(payload_kg, rng)
    tool = draw_load("tool", payload_kg, rng)
    bodies = _bodies(chain)
    masses, coms = np.array([b.mass_kg for b in bodies]), np.array([b.com_m for b in bodies])
    rated = rated_torque_nm(chain, masses, coms, tool, rng)
    link_std = float(rng.uniform(*levels.cad_std))
    cad = np.column_stack([masses, masses[:, None] * coms]).ravel()
    links_std = link_std * cad_scale(chain)
    gain_std = rng.uniform(*levels.gain_std) * rng.uniform(0.8, 1.25, 6)
    friction = draw_friction(rated, levels, rng)
    noise, resolution = rated * rng.uniform(0.002, 0.012, 6), rated * rng.uniform(0.0002, 0.001, 6)
    samples = int(rng.integers(40, 200))
    floor = np.hypot(friction.half_sum_std_nm(friction.coulomb_nm, friction.coulomb_nm), noise / np.sqrt(2.0 * samples))
    cogging_rms = rng.uniform(*levels.cogging_ratio, 6) * floor
    # four amplitudes of the same standard deviation: RMS of the sum is sqrt(2) of it
    cogging_std = cogging_rms / np.sqrt(2.0)
    gear_ratio = np.round(rng.uniform(50.0, 200.0, 6))
    arm = NatureArm(
        chain=chain,
        links=cad + _cad_errors(links_std, levels, rng),
        links_std=links_std,
        tool=tool,
        rated_nm=rated,
        gain=gain_std * rng.standard_normal(6),
        gain_std=gain_std,
        friction=friction,
        cogging_nm=cogging_std[:, None] * rng.standard_normal((6, 4)),
        cogging_std_nm=cogging_std,
        gear_ratio=gear_ratio,
        repeat_rad=rng.uniform(*levels.repeat_rad, 6),
        backlash_rad=rng.uniform(*levels.backlash_rad, 6),
        noise_nm=noise,
        resolution_nm=resolution,
        samples=samples,
        floor_nm=floor,
        gravity_m_s2=GRAVITY,
    )
    misstated = bool(rng.random() < 1.0 / 6.0)
    factor = float(rng.choice([0.5, 2.0])) if misstated else 1.0
    known_ratio = bool(rng.random() < 0.8)
    stated = Stated(
        urdf=write_chain(replace(chain, name="cad")),
        link_std=factor * link_std,
        gain_std=factor * gain_std,
        efficiency=friction.declared_efficiency,
        gear_ratio=gear_ratio if known_ratio else None,
        misstated=misstated,
    )
    return arm, stated


def cad_scale(chain: SimChain) -> Array:
    """What a trust of 1 stands for (24,): every link's mass [kg], and mass x length of the link [kg m] three times.

    The length is that to the next joint or to the centre of mass, whichever is further; the last link is taken to be no
    shorter than the step before it.
    """
    steps = np.linalg.norm(chain.placement[:, :3, 3], axis=1)
    bodies = _bodies(chain)
    scale = np.zeros(24)
    for link, body in enumerate(bodies):
        onward = float(steps[min(link + 1, 5)])
        length = max(onward, float(np.linalg.norm(body.com_m)), SHORTEST_LINK_M)
        scale[4 * link : 4 * link + 4] = body.mass_kg * np.array([1.0, length, length, length])
    return scale


def _cad_errors(links_std: Array, levels: Harshness, rng: np.random.Generator) -> Array:
    """Errors (24,) of standard deviation `links_std` in all; outliers are whole links, as a forgotten motor is."""
    share = levels.cad_outliers[0]
    width = np.where(rng.random(6) < share, 2.5, 1.0) / np.sqrt(1.0 + share * (2.5**2 - 1.0))
    return links_std * np.repeat(width, 4) * np.clip(rng.standard_normal(24), -MOST_SIGMAS, MOST_SIGMAS)


def _bodies(chain: SimChain) -> list[SimBody]:
    bodies = [body for body in chain.bodies if body is not None]
    if len(bodies) != 6:
        raise ValueError("every link of a drawn arm has an inertial")
    return bodies
