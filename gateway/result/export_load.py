"""One load of a result as it is handed over: complete, plausible, in one frame; what is not is refused."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from drives.profile_parts import is_assumed
from gateway.errors import ConfigError, DataUnusable
from gateway.model.load_bounds import NO_ARM
from gateway.result.inertia import Floats, has_a_body, tensor_of
from gateway.result.interval import SAID, half_width

if TYPE_CHECKING:
    from gateway.result.drawn import Drawn
    from gateway.result.result import LoadResult
    from gateway.result.values import Numbers, Vector

INERTIA_NOTE = "inertia not measured (no motion reveals it at rest)"


@dataclass(frozen=True, slots=True)
class ExportLoad:
    """One load that is complete enough to be handed over.

    Parameters
    ----------
    label : str
        Name of the load in the result.
    mass_kg, mass_std_kg : float
        Mass and its standard deviation, kg; NaN = unknown.
    com_m, com_std_m : tuple of 3 float
        Centre of gravity in `frame`, m, and its standard deviation; None = unknown.
    frame : str
        `flange` or `link_6`.
    flange_source : str or None
        Where the cell file has the flange from; begins with `assumed` where its place or turn is. None = not stated,
        or another frame.
    inertia_kg_m2 : tuple of 6 float or None
        [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] about the centre of gravity, axes of `frame`; None = not handed over.
    inertia_note : str
        How well it is known, or why it is not handed over.
    """

    label: str
    mass_kg: float
    mass_std_kg: float
    com_m: Vector
    com_std_m: Vector | None
    frame: str
    flange_source: str | None = None
    inertia_kg_m2: Numbers | None = None
    inertia_note: str = INERTIA_NOTE

    @property
    def frame_note(self) -> str:
        """The frame that the centre of gravity is in, and where the flange comes from."""
        return self.frame if self.flange_source is None else f"{self.frame} ({self.flange_source})"

    @property
    def flange_is_assumed(self) -> bool:
        """Whether place or turn of the flange was assumed."""
        return is_assumed(self.flange_source or "")

    @property
    def tensor_kg_m2(self) -> Floats | None:
        """The inertia (3, 3)."""
        return None if self.inertia_kg_m2 is None else tensor_of(self.inertia_kg_m2)


def complete(load: LoadResult, frames: Sequence[str], drawn: Drawn | None) -> ExportLoad:
    """A load in the first of the frames that it is given in.

    Raises
    ------
    ConfigError
        The flange is needed and not given.
    DataUnusable
        No mass, no complete centre of gravity, or what no load has.
    """
    if not math.isfinite(load.mass_kg):
        raise DataUnusable(f"load '{load.label}' has no mass to hand over: {load.refused or _unidentifiable(load)}")
    if load.com_flange_m is not None and "flange" in frames:
        in_flange = None if drawn is None else drawn.flange.get(load.label)
        source = None if drawn is None or drawn.flange_source is None else one_line(drawn.flange_source)
        checked = _checked(load, load.com_flange_m, None if in_flange is None else in_flange.com_std_m, "flange")
        return replace(checked, flange_source=source)
    if "link_6" in frames and load.com_m is not None:
        return _checked(load, load.com_m, load.com_std_m, one_line(load.frame))
    if load.com_m is None or not all(map(math.isfinite, load.com_m)):
        raise DataUnusable(f"load '{load.label}' has no centre of gravity to hand over: {_unidentifiable(load)}")
    raise ConfigError(
        f"load '{load.label}': the controller wants the centre of gravity in the flange frame, and the flange is not "
        "given; add flange_xyz_m and flange_rpy_rad (flange in link_6) to the cell file, estimate again with --cell"
    )


def _checked(load: LoadResult, com: Vector, std: Vector | None, frame: str) -> ExportLoad:
    if not all(map(math.isfinite, com)):
        raise DataUnusable(
            f"load '{load.label}': the centre of gravity is not complete ({_unidentifiable(load)}); measure the poses "
            "that the result names under `next`"
        )
    if not load.mass_kg > 0:
        raise DataUnusable(
            f"load '{load.label}' has a mass of {load.mass_kg:g} kg: no load weighs that, and a controller that is told"
            " so lets the arm fall; check signs and the bare run with diagnose, then measure again"
        )
    wrong = NO_ARM.violation(load.mass_kg, com)
    if wrong:
        raise DataUnusable(f"load '{load.label}': {wrong}; measure it again, or enter it by hand")
    known = std is not None and all(map(math.isfinite, std))
    inertia, note = _inertia(load, load.inertia_flange_kg_m2 if frame == "flange" else load.inertia_kg_m2)
    label = one_line(load.label)
    measured = (label, load.mass_kg, load.mass_std_kg, com, std if known else None, frame)
    return ExportLoad(*measured, inertia_kg_m2=inertia, inertia_note=note)


def _inertia(load: LoadResult, in_frame: Numbers | None) -> tuple[Numbers | None, str]:
    """Inertia in the frame that is handed over, and what is said of it."""
    if load.inertia_kg_m2 is None:
        return None, INERTIA_NOTE
    if not all(map(math.isfinite, load.inertia_kg_m2)):
        return None, f"inertia not complete ({_unidentifiable(load)})"
    if in_frame is None:
        return None, "inertia not in the frame of the flange: estimate again with --cell"
    if not has_a_body(tensor_of(in_frame)):
        return None, "inertia left out: no body has the one in the result"
    most = max(map(half_width, load.inertia_std_kg_m2 or (math.nan,)))
    known = f" +- {most:.3g} kg m2 at most ({SAID})" if math.isfinite(most) else ""
    return in_frame, f"inertia about the centre of gravity{known}"


def _unidentifiable(load: LoadResult) -> str:
    return f"not identifiable: {', '.join(load.unidentifiable)}" if load.unidentifiable else "it was not estimated"


def number_text(value: float, digits: int) -> str:
    """A number with so many decimals; zero without a sign."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text


def one_line(text: str) -> str:
    """Text that cannot leave its line."""
    return "".join(character if character.isprintable() else " " for character in text).strip()


def identifier(label: str) -> str:
    """A label as a name of a controller's language."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", label)
    return (name if name[:1].isalpha() else f"load_{name}")[:28]


def accuracy(load: ExportLoad) -> str:
    """Mass and centre of gravity with their intervals, in words."""
    mass = f"{load.mass_kg:.3f} kg"
    if math.isfinite(load.mass_std_kg):
        mass += f" +- {half_width(load.mass_std_kg):.3f} kg"
    if load.com_std_m is None:
        return f"{mass} ({SAID})"
    x, y, z = (1000 * half_width(value) for value in load.com_std_m)
    return f"{mass}, centre of gravity +- {x:.1f} {y:.1f} {z:.1f} mm ({SAID})"
