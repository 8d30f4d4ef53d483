"""Effects of the diagnosis: one file per effect, named after it, with an `EFFECT`."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Final

from gateway.model.effect import Effect, MotionSetup, RestSetup
from gateway.model.motion import MovingRows
from gateway.model.term import Term
from gateway.model.visits import Visits


def _read() -> dict[str, Effect]:
    files = sorted(module.name for module in pkgutil.iter_modules(__path__))
    effects: list[Effect] = [import_module(f"{__name__}.{name}").EFFECT for name in files]
    return {effect.name: effect for effect in effects}


#: Effects by name.
LIBRARY: Final[Mapping[str, Effect]] = _read()
#: Effects that wrong link parameters of the robot model can imitate.
DRAWN: Final = frozenset(effect.name for effect in LIBRARY.values() if effect.drawn)
#: Effects that the odds alone decide: links far from the robot model predict left-out samples as well as a body does.
BY_ODDS: Final = frozenset(effect.name for effect in LIBRARY.values() if effect.by_odds)
#: Effects that are friction.
FRICTION: Final = frozenset(effect.name for effect in LIBRARY.values() if effect.friction)
#: Commissioning mistakes, each with what is wrong and what to do.
MISTAKES: Final = {effect.name: effect.mistake for effect in LIBRARY.values() if effect.mistake is not None}


def terms_at_rest(rows: Visits, setup: RestSetup, allowed: Iterable[str] = LIBRARY) -> list[Term]:
    """Return every effect at every location and in every form that rest visits can show."""
    return [term for name in sorted(allowed) for term in LIBRARY[name].at_rest(rows, setup)]


def terms_in_motion(motion: MovingRows, setup: MotionSetup, allowed: Iterable[str] = LIBRARY) -> list[Term]:
    """Return every effect at every location and in every form for moving samples, except residual-based ones."""
    effects = [LIBRARY[name] for name in sorted(allowed) if not LIBRARY[name].by_residual]
    return [term for effect in effects for term in effect.in_motion(motion, setup)]


def terms_by_residual(motion: MovingRows, setup: MotionSetup, allowed: Iterable[str] = LIBRARY) -> list[Term]:
    """Return the candidates in motion that the residual of the present model suggests."""
    effects = [LIBRARY[name] for name in sorted(allowed) if LIBRARY[name].by_residual]
    return [term for effect in effects for term in effect.in_motion(motion, setup)]
