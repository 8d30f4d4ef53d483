"""Load of a result for export: complete, plausible and in one frame; otherwise refused with the reason."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import TYPE_CHECKING

from drives.printable import one_line
from drives.profile import is_assumed
from gateway.errors import ConfigError, DataUnusable
from gateway.model.load_bounds import NO_ARM
from gateway.result.inertia import Floats, has_a_body, tensor_of
from gateway.result.numerals import SAID, half_width, holds_zero, with_interval

if TYPE_CHECKING:
    from gateway.result.drawn import Drawn
    from gateway.result.result import LoadResult
    from gateway.result.values import Numbers, Vector

#: Longest name of a load in a controller's language, and on the screen of a Smart Pendant [characters].
NAME_WIDTH = 28
SCREEN_WIDTH = 16
INERTIA_NOTE = "inertia not measured (no motion reveals it at rest)"


@dataclass(frozen=True, slots=True)
class ExportLoad:
    """One load with all values that an export requires.

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
    name, screen_name : str
        Its name in a controller's language and on a small screen, different from those of the result's other loads.
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
    name: str = ""
    screen_name: str = ""

    @property
    def frame_note(self) -> str:
        """Frame of the centre of gravity, and origin of the flange frame."""
        return self.frame if self.flange_source is None else f"{self.frame} ({self.flange_source})"

    @property
    def flange_is_assumed(self) -> bool:
        """Return whether position or orientation of the flange was assumed."""
        return is_assumed(self.flange_source or "")

    @property
    def tensor_kg_m2(self) -> Floats | None:
        """Inertia tensor (3, 3)."""
        return None if self.inertia_kg_m2 is None else tensor_of(self.inertia_kg_m2)

    @property
    def heading(self) -> str:
        """Label for a remark with a reduced character set; the unique name where the label would be ambiguous."""
        return self.label if self.name == identifier(self.label) else self.name


def complete(load: LoadResult, frames: Sequence[str], drawn: Drawn | None) -> ExportLoad:
    """Return a load in the first of `frames` in which it is known.

    Raises
    ------
    ConfigError
        The flange is needed and not given.
    DataUnusable
        No mass, no complete centre of gravity, or an implausible value.
    """
    if not math.isfinite(load.mass_kg):
        raise DataUnusable(f"load '{load.label}' has no mass to export: {load.refused or _unidentifiable(load)}")
    if load.com_flange_m is not None and "flange" in frames:
        in_flange = None if drawn is None else drawn.flange.get(load.label)
        source = None if drawn is None or drawn.flange_source is None else one_line(drawn.flange_source)
        checked = _checked(load, load.com_flange_m, None if in_flange is None else in_flange.com_std_m, "flange")
        return replace(checked, flange_source=source)
    if "link_6" in frames and load.com_m is not None:
        return _checked(load, load.com_m, load.com_std_m, one_line(load.frame))
    if load.com_m is None or not all(map(math.isfinite, load.com_m)):
        raise DataUnusable(f"load '{load.label}' has no centre of gravity to export: {_unidentifiable(load)}")
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
    if holds_zero(load.mass_kg, load.mass_std_kg):
        raise DataUnusable(
            f"load '{load.label}': {with_interval(load.mass_kg, load.mass_std_kg)} kg ({SAID}), no load is detected:"
            " mount it and measure it again, or at more poses if it was mounted"
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
    """Return the inertia in the exported frame, and a note on its accuracy."""
    if load.inertia_kg_m2 is None:
        return None, INERTIA_NOTE
    if not all(map(math.isfinite, load.inertia_kg_m2)):
        return None, f"inertia not complete ({_unidentifiable(load)})"
    if in_frame is None:
        return None, "inertia not in the frame of the flange: estimate again with --cell"
    if not has_a_body(tensor_of(in_frame)):
        return None, "inertia omitted: the result is not that of a rigid body"
    most = max(map(half_width, load.inertia_std_kg_m2 or (math.nan,)))
    known = f" +- {most:.3g} kg m2 at most ({SAID})" if math.isfinite(most) else ""
    return in_frame, f"inertia about the centre of gravity{known}"


def _unidentifiable(load: LoadResult) -> str:
    return f"not identifiable: {', '.join(load.unidentifiable)}" if load.unidentifiable else "it was not estimated"


def number_text(value: float, digits: int) -> str:
    """Return a number with `digits` decimals; zero without a sign."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text


def identifier(label: str, width: int = NAME_WIDTH) -> str:
    """Return a label as an identifier of a controller language; see `unique_names` for equal ones."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", label)
    return (name if name[:1].isalpha() else f"load_{name}")[:width]


def unique_names(labels: Sequence[str], width: int = NAME_WIDTH) -> dict[str, str]:
    """Return identifiers by label, unique without regard to upper and lower case.

    Labels with equal identifiers get a digest of the label appended, so that a name does not depend on the order.

    Raises
    ------
    DataUnusable
        Two loads have the same label, or labels that differ in what cannot be printed.
    """
    plain = {label: identifier(label, width) for label in labels}
    count = Counter(name.casefold() for name in plain.values())
    names = {
        label: name if count[name.casefold()] == 1 else f"{name[: width - 7]}_{sha256(label.encode()).hexdigest()[:6]}"
        for label, name in plain.items()
    }
    if not len({name.casefold() for name in names.values()}) == len(set(map(one_line, labels))) == len(labels):
        raise DataUnusable(
            f"the loads {', '.join(labels)} get equal names in the file of a controller: give each load a"
            " label of its own and measure or import it again"
        )
    return names


def accuracy(load: ExportLoad) -> str:
    """Return mass and centre of gravity with their intervals as text."""
    mass = f"{load.mass_kg:.3f} kg"
    if math.isfinite(load.mass_std_kg):
        mass += f" +- {half_width(load.mass_std_kg):.3f} kg"
    if load.com_std_m is None:
        return f"{mass} ({SAID})"
    x, y, z = (1000 * half_width(value) for value in load.com_std_m)
    return f"{mass}, centre of gravity +- {x:.1f} {y:.1f} {z:.1f} mm ({SAID})"
