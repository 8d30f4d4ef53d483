"""Embodiments of CN104379308 as configurations of the same components, and the rows of the comparison.

Each row names the first function that it needs, which hand yields to force, and what is learned. The controller does
not depend on a row's name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from gateway.pair.impedance import Gains
from gateway.pair.learning_points import Feature, Selection
from gateway.pair.learning_update import Forgetting, LearningRule

#: Twice the damping at which a chain of 1.6e5 N/m, 3.6e3 Nm/rad with a loop time of 35 ms oscillates.
DEFAULT_GAINS = Gains(damping=(7.2e3, 160.0))
#: Twice the damping [s] at which a distance loop of 35 ms oscillates.
DISTANCE_GAINS = Gains(damping=(0.045, 0.045))
FORCE_POINTS = Selection(features=(Feature("force", 10.0),), gain_n=3.0, apart_m=0.002)

First = Literal["fixed", "taught", "speed_table", "exact"]
Hands = Literal["none", "slave", "master", "both"]


@dataclass(frozen=True, slots=True)
class Embodiment:
    """One configuration of the pair.

    Attributes
    ----------
    name, text : for tables
    first : what first function it needs: one fixed relation, taught points, stored speeds, or the simulator's truth
    corrects : which hands yield to force
    gains : impedance of a yielding hand; doubled by the controller when both yield
    dead_band : (force [N], moment [Nm]) that is not corrected
    sensing : "force", or "distance" (then `[m]`, `[rad]` replace `[N]`, `[Nm]`, and damping is in s)
    learning : None = the first function stays
    points : learning points of the first function
    """

    name: str
    text: str
    first: First = "taught"
    corrects: Hands = "slave"
    gains: Gains = DEFAULT_GAINS
    dead_band: tuple[float, float] = (0.0, 0.0)
    sensing: Literal["force", "distance"] = "force"
    learning: LearningRule | None = None
    points: int = 9


_UNIFORM = LearningRule(cycles=3)
_ROWS = (
    Embodiment("A", "one fixed relation", first="fixed", corrects="none"),
    Embodiment("B", "one fixed relation, impedance", first="fixed"),
    Embodiment("C1", "E1: taught function", corrects="none"),
    Embodiment("C1i", "E1 with E4: taught function, impedance"),
    Embodiment(
        "C2m", "E2: learned each cycle from measured positions", learning=LearningRule(source="measured", lead_s=0.0)
    ),
    Embodiment("C2c", "E2: learned each cycle from commands", learning=LearningRule()),
    Embodiment("C3", "E3: function interpolated between learned speeds", first="speed_table"),
    Embodiment(
        "E5",
        "E5: gap kept by distance sensors",
        first="fixed",
        sensing="distance",
        gains=DISTANCE_GAINS,
        # a gap is measured directly: its correction does not depend on a stiffness
        learning=LearningRule(left_share=1.0),
        points=100,
    ),
    Embodiment(
        "C6",
        "E6: learned each cycle, with forgetting",
        learning=LearningRule(forgetting=Forgetting(gamma=0.05, phi=0.6)),
    ),
    Embodiment("C7", "E7: representative of 3 cycles", learning=_UNIFORM),
    Embodiment(
        "C8", "E8: learning points where force acts", learning=replace(_UNIFORM, cycles=2, selection=FORCE_POINTS)
    ),
    Embodiment("C8u", "as C8, points spread evenly", learning=_UNIFORM, points=20),
    Embodiment(
        "C8r",
        "E8 as printed: points replaced",
        learning=replace(_UNIFORM, selection=replace(FORCE_POINTS, keep="replace")),
    ),
    Embodiment("O", "exact relation at every command", first="exact", corrects="none"),
)
EMBODIMENTS: Mapping[str, Embodiment] = {row.name: row for row in _ROWS}


def with_gains(embodiment: Embodiment, gains: Gains) -> Embodiment:
    """Return a copy of the embodiment with another impedance."""
    return replace(embodiment, gains=gains)
