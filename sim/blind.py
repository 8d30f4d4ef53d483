"""Strength of an undeclared effect, and effects drawn near a wanted strength.

The strength of an effect is its part of the measured rows that link and load parameters cannot absorb. Its torques are
weighted by the noise floor of each axis and projected on the base and load columns, with the prior on the link
parameters as rows. The strength is the RMS of the remainder over the visits, on the axis where that is largest. For an
effect between the two sides of a visit: RMS of half the difference after removing each axis's mean, over the floor.
Nuisance parameters may be projected out as well: errors of the torque constants and a bias of friction by direction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sim.draw import DrawnArm
from sim.draw_effects import MISTAKES, Effect, Maker
from sim.effects import apply_effects
from sim.offline import PlannedVisit, gravity_columns, measure, point_jacobian

Array = NDArray[np.float64]
Drawn = TypeVar("Drawn")

LEAST_STRENGTH, MOST_STRENGTH = 1.5, 20.0
#: Nuisance parameters, one standard deviation: relative error of a torque constant, bias by direction over the band.
GAIN_STD, BIAS_SHARE = 0.03, 0.1


def planned(poses_rad: Array, starts_s: Mapping[str, float], visit_s: float) -> list[PlannedVisit]:
    """Visits of the same poses (n, N) with each load, from the instant at which its first one starts."""
    return [
        PlannedVisit(pose, load, start_s + visit_s * pose, q)
        for load, start_s in starts_s.items()
        for pose, q in enumerate(poses_rad)
    ]


def wanted_strength(rng: np.random.Generator) -> float:
    """Strength to aim at: 1.5 to 20, every factor as likely."""
    return float(np.exp(rng.uniform(np.log(LEAST_STRENGTH), np.log(MOST_STRENGTH))))


def applies(name: str, arm: DrawnArm, two: bool) -> bool:
    """Whether an effect can be drawn: a common scale shows against a weighed load alone, a shift needs a load."""
    stated = {"torque_constant_scale_common": arm.known, "payload_shift": arm.loads}.get(name, True)
    return bool(stated) and not (two and name in MISTAKES)


def scaled(
    arm: DrawnArm, visits: list[PlannedVisit], maker: Maker, wanted: float, rng: np.random.Generator
) -> tuple[Effect, float]:
    """An effect whose strength is `wanted`, as far as its physical limit lets it."""
    return closest(lambda: maker(arm, rng), lambda effect: strength(left_over(arm, visits, effect)), wanted)


def closest(
    draw: Callable[[], tuple[Callable[[float], Drawn], float | None]],
    strength_of: Callable[[Drawn], float],
    wanted: float,
) -> tuple[Drawn, float]:
    """Of several drawn effects the one whose strength, with its size scaled up to its limit, is closest to `wanted`.

    An effect without a limit has no size; its strength is infinite.
    """
    best: tuple[Drawn, float] | None = None
    for _ in range(4):
        build, limit = draw()
        if limit is None:
            return build(0.0), float("inf")
        size = 0.1 * limit
        for _ in range(4):
            reached = strength_of(build(size))
            size = min(limit, size * wanted / max(reached, 1e-12))
        effect = build(size)
        reached = strength_of(effect)
        if best is None or abs(np.log(max(reached, 1e-9) / wanted)) < abs(np.log(max(best[1], 1e-9) / wanted)):
            best = effect, reached
        if reached > 0.95 * wanted:
            break
    if best is None:
        raise ValueError("no effect was drawn")
    return best


def strength(left: tuple[Array, Array, Array]) -> float:
    """Projected strength of an effect over the noise floor, as the module text defines it, from what is left of it."""
    return float(max(np.sqrt(np.mean(part**2, axis=0)).max() for part in left[:2]))


def distance(left: tuple[Array, Array, Array]) -> float:
    """Distance of an effect from anything that links, load and nuisance parameters make, in standard deviations.

    It is the length of all that is left of the rows of a table, and of how far the best parameters are from what is
    stated (Mahalanobis distance). Half its square is the expected log likelihood ratio.
    """
    return float(np.linalg.norm(np.concatenate([part.ravel() for part in left])))


def left_over(
    arm: DrawnArm,
    visits: Sequence[PlannedVisit],
    effect: Mapping[str, object],
    gain_std: float | Array = 0.0,
    bias_share: float = 0.0,
) -> tuple[Array, Array, Array]:
    """Return what is left of an effect of half sums (n, 6) and half differences (n, 6), and the parameters (k,).

    Rows are over the noise floor, the parameters that absorb the rest over their stated standard deviations. `gain_std`
    and `bias_share` state one standard deviation of the nuisance parameters that are projected out too.
    """
    quiet = replace(arm.protocol, settle=np.zeros(6), resolution_nm=np.zeros(6), samples=1)
    still = replace(arm.plant, reading_noise_nm=np.zeros(6))
    rng = np.random.default_rng(0)
    changed = apply_effects(still, [effect], point_jacobian(arm.chain))
    with_, without = (
        _halves(measure(arm.chain, plant, visits, arm.loads, quiet, rng), arm.efficiency) for plant in (changed, still)
    )
    half_sum = (with_[0] - without[0]) / arm.floor_nm
    half_difference = with_[1] - without[1]
    half_difference = (half_difference - half_difference.mean(axis=0)) / arm.floor_nm
    q = np.array([visit.q_rad for visit in visits])
    links = gravity_columns(arm.chain, q, arm.plant.gravity_m_s2) / arm.floor_nm[:, None]
    loaded = np.array([visit.load != "none" for visit in visits], dtype=float)
    modelled, band = without[0] / arm.floor_nm, np.ones_like(without[0]) * arm.plant.coulomb_nm / arm.floor_nm
    columns = [(links * arm.prior_std).reshape(-1, 24)]
    columns += [(np.eye(6) * part[:, :, None]).reshape(-1, 6) for part in (gain_std * modelled, bias_share * band)]
    free = 0
    if not arm.known:
        columns.append((links[:, :, 20:] * loaded[:, None, None]).reshape(-1, 4))
        free = 4
    known = 24 + 6 + 6
    prior = np.eye(known, known + free)
    design = np.vstack([np.hstack(columns), prior])
    target = np.append(half_sum.ravel(), np.zeros(known))
    fit, *_ = np.linalg.lstsq(design, target, rcond=None)
    left = target - design @ fit
    return left[: half_sum.size].reshape(-1, 6), half_difference, left[half_sum.size :]


def _halves(columns: Mapping[str, NDArray[Any]], efficiency: Array) -> tuple[Array, Array]:
    """Half sum and half difference (visits, 6) of rows up, down; each side through the gear by its own direction."""
    sides = []
    for side, direction in ((slice(0, None, 2), 1.0), (slice(1, None, 2), -1.0)):
        motor = columns["tau_nm"][side]
        sides.append(np.where(motor * direction > 0, motor * efficiency, motor / efficiency))
    return (sides[0] + sides[1]) / 2.0, (sides[0] - sides[1]) / 2.0
