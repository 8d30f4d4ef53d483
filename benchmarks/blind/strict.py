"""Strict scores: an answer is right when exactly what is there is named, and what is named is there.

``improved`` with a wrong name is a misname. ``undecided`` is right for one effect that is in a list of at most two.
What is too weak to be asked for may be named, since it is there, and may be left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Place = tuple[str, tuple[int, ...]]

LEAST, STRONG = 1.5, 3.0
LONGEST_LIST = 2


@dataclass(frozen=True, slots=True)
class There:
    """One effect that is there: names and joints that are right for it, and its strength."""

    names: frozenset[Place]
    strength: float

    @property
    def counts(self) -> bool:
        """Whether it is strong enough to be asked for."""
        return self.strength >= LEAST


@dataclass(frozen=True, slots=True)
class Said:
    """What was said: names with joints, and the verdict."""

    found: tuple[Place, ...]
    verdict: str


def there(names: Iterable[str], joints: Sequence[int], strength: float) -> There:
    """An effect on given joints that has one of several right names."""
    return There(frozenset((name, tuple(joints)) for name in names), strength)


def right(truth: Sequence[There], said: Said) -> bool:
    """Whether exactly what is there is named."""
    asked = [effect for effect in truth if effect.counts]
    if said.verdict == "undecided":
        listed = 0 < len(said.found) <= LONGEST_LIST
        return listed and len(asked) == 1 and any(place in asked[0].names for place in said.found)
    if said.verdict not in ("explained", "improved"):
        return not asked and not said.found
    every = all(any(place in effect.names for place in said.found) for effect in asked)
    return every and len(said.found) <= len(truth) and not misnamed(truth, said)


def misnamed(truth: Sequence[There], said: Said) -> bool:
    """Whether something is named that is not there; the second name of a short list with the right one is none."""
    known = frozenset[Place]().union(*(effect.names for effect in truth))
    if said.verdict == "undecided" and len(said.found) <= LONGEST_LIST and any(place in known for place in said.found):
        return False
    return any(place not in known for place in said.found)


def kind(truth: Sequence[There]) -> str:
    """Where a cell is counted: strong, weak or several, by the effects that count; below where none does."""
    asked = [effect for effect in truth if effect.counts]
    if not asked:
        return "below"
    if len(asked) > 1:
        return "several"
    return "strong" if asked[0].strength >= STRONG else "weak"
