"""Effect: a body on a link that the robot model does not contain, such as a welding unit or a hose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gateway.model.effect import Effect, MotionSetup, RestSetup
from gateway.model.motion import PER_BODY, Modelled, MovingRows
from gateway.model.rest import AlteredModel
from gateway.model.robot import link_lengths_m
from gateway.model.term import NAN, Named, OnAxis, Seen, Term, plus
from gateway.model.visits import Visits

Floats = NDArray[np.float64]

#: Largest distance of a body on a link from the origin of the link [m].
FARTHEST_M: Final = 2.0
#: Standard deviations beyond a bound from which a body is impossible: one in a thousand by chance.
BOUND_SIGMAS: Final = 3.0
#: Prior standard deviations of a body's mass over that of the arm: a valve block, and a welding unit.
SHARES: Final = (0.02, 0.1)


@dataclass(frozen=True, slots=True)
class LinkMass(OnAxis):
    """Additional body [m, hx, hy, hz] on one link; identifiable as far as the prior of the links allows.

    `drawn` [m, hx, hy, hz] is the link in the robot model, `arm_kg` the mass of all links; None = not known. `size` are
    the prior standard deviations of mass [kg] and first moment [kg m].
    """

    drawn: tuple[float, float, float, float] | None = None
    arm_kg: float = NAN
    size: tuple[float, float] = (NAN, NAN)

    name: ClassVar[str] = "link_mass"
    parameters: ClassVar[tuple[str, ...]] = (
        "mass_kg",
        "first_moment_x_kg_m",
        "first_moment_y_kg_m",
        "first_moment_z_kg_m",
    )
    linear: ClassVar[tuple[bool, ...]] = (True, True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN, NAN, NAN)

    @property
    def spread(self) -> tuple[float, ...]:
        mass_kg, moment_kg_m = self.size
        return mass_kg, moment_kg_m, moment_kg_m, moment_kg_m

    def enters(self, axes: int) -> tuple[int, ...]:
        return tuple(range(axes))

    def apply(self, setting: AlteredModel, theta: Floats, rows: Visits) -> AlteredModel:
        part = slice(4 * self.axis, 4 * self.axis + 4)
        return replace(setting, link_extra=plus(setting.link_extra, part, theta))

    def columns(self, motion: MovingRows, modelled: Modelled) -> Floats:
        return motion.rigid[:, :, PER_BODY * self.axis : PER_BODY * self.axis + 4]

    def bodies(self, value: Floats, count: int) -> Floats:
        added = np.zeros(count)
        added[PER_BODY * self.axis : PER_BODY * self.axis + 4] = value
        return added

    def exists(self, theta: Floats, std: Floats) -> bool:
        """Return True if the mass is physically possible: a negative mass may not exceed the mass of the link.

        A negative mass corrects a CAD mass that is too large.
        """
        return self.drawn is None or _is_body(np.array(self.drawn) + theta, std, theta[0], self.arm_kg)

    def possible(self, value: Floats, std: Floats, seen: Seen) -> bool:
        """Return True if it may be a body: at rest the columns also correct a CAD mass, so that the sign is free."""
        return _is_body(value, std, value[0], float(np.nansum(seen.motion.robot.mass_kg)))

    def named(self, theta: Floats) -> Named:
        return OnAxis.named(self, theta) | {"first_moment_kg_m": float(np.linalg.norm(theta[1:]))}


def _is_body(body: Floats, std: Floats, added_kg: float, arm_kg: float) -> bool:
    """Return True if [m, hx, hy, hz] with standard deviations may be a body, and what is added lighter than the arm."""
    most = float(body[0]) + BOUND_SIGMAS * float(std[0])
    far = float(np.linalg.norm(body[1:])) - BOUND_SIGMAS * float(np.linalg.norm(std[1:]))
    return bool(most > 0.0 and far < FARTHEST_M * most and added_kg - BOUND_SIGMAS * std[0] < arm_kg)


def _links(axes: int) -> range:
    """Return the links (from 0) that carry the wrist: those on which bodies are mounted."""
    return range(1, axes - 2)


def _at_rest(rows: Visits, setup: RestSetup) -> Iterator[Term]:
    if setup.links is None:
        yield from (LinkMass(link) for link in _links(rows.axes))
        return
    drawn = setup.links.reshape(-1, 4)
    arm_kg = float(np.nansum(drawn[:, 0]))
    shares, lengths_m = (NAN,), np.full(rows.axes, NAN)
    if setup.robot is not None and arm_kg > 0.0:
        lengths_m = link_lengths_m(setup.robot)
        # a body on a short link may be as far out as on the others
        shares, lengths_m = SHARES, np.maximum(lengths_m, lengths_m.mean())
    for link in _links(rows.axes):
        m, x, y, z = (float(value) for value in drawn[link])
        known = (m, x, y, z) if np.isfinite([m, x, y, z]).all() else None
        for mass_kg in (share * arm_kg for share in shares):
            yield LinkMass(link, known, arm_kg, (mass_kg, mass_kg * float(lengths_m[link])))


def _in_motion(motion: MovingRows, setup: MotionSetup) -> Iterator[Term]:
    if setup.drawn:
        yield from (LinkMass(link) for link in _links(motion.axes))


EFFECT: Final = Effect(
    name="link_mass",
    words="extra mass on a link",
    meaning="a welding unit or hose on the forearm",
    parameters=(
        "mass_kg",
        "first_moment_kg_m",
        "first_moment_x_kg_m",
        "first_moment_y_kg_m",
        "first_moment_z_kg_m",
    ),
    at_rest=_at_rest,
    in_motion=_in_motion,
    drawn=True,
    by_odds=True,
)
