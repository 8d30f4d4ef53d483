"""Text of numbers with their uncertainty, equal on pages, in the terminal and in findings.

Every plus-minus is the half width of a 95 % interval. Files contain standard deviations. If the noise was estimated
from few readings, these are already widened by the ratio of Student's quantile to the normal one. Therefore
`TWO_SIDED_95` standard deviations cover the true value in 95 %.
"""

from __future__ import annotations

import math
import re
from typing import Final

#: Two-sided 95 % quantile of the normal distribution.
TWO_SIDED_95: Final = 1.96
#: Text beside a number with a plus-minus.
SAID: Final = "95 %"
PLUS_MINUS: Final = "\N{PLUS-MINUS SIGN}"
MINUS: Final = "\N{MINUS SIGN}"
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
_TIMES_TEN: Final = "\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}10"
#: From here on a half width has more than two digits before the point.
_TWO_DIGITS: Final = 100.0
#: Powers of ten between which a number is written out.
_LEAST_POWER: Final = -4
_MOST_POWER: Final = 7
_VALUE = r"[-\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
#: An angle in a sentence: `0.3 rad`, `-1 to 1 rad/s`, `[0.1, 0.2] rad`, `3.6 mrad`.
_ANGLE: Final = re.compile(
    rf"(?:\[(?P<list>{_VALUE}(?:, {_VALUE})*)\]|(?:(?P<low>{_VALUE}) to )?(?P<value>{_VALUE}))"
    r" (?P<unit>m?rad)(?P<per>/s[23]?)?(?![\w/(])(?! \()"
)
#: Largest number taken for a joint angle [rad]: two turns.
_FARTHEST_RAD: Final = 4 * math.pi


def half_width(std: float) -> float:
    """Return the half width of the 95 % interval for a standard deviation; NaN if it is unknown."""
    return TWO_SIDED_95 * std


def holds_zero(value: float, std: float) -> bool:
    """Return whether the interval of a quantity contains 0; False if its uncertainty is unknown or zero."""
    return math.isfinite(value) and math.isfinite(std) and std > 0 and abs(value) <= half_width(std)


def with_degrees(text: str) -> str:
    """Return a text with degrees beside every angle in radians: `0.3 rad (17.2 deg)`."""
    return _ANGLE.sub(_beside, text) if "rad" in text else text


def _beside(found: re.Match[str]) -> str:
    scale = 1e-3 if found["unit"] == "mrad" else 1.0
    listed = found["list"].split(", ") if found["list"] else [each for each in (found["low"], found["value"]) if each]
    angles = [scale * float(each.replace(MINUS, "-")) for each in listed]
    if not found["per"] and max(map(abs, angles)) > _FARTHEST_RAD:
        return found[0]
    degrees = [f"{math.degrees(angle):.3g}" if abs(angle) < 1 else f"{math.degrees(angle):.1f}" for angle in angles]
    said = f"[{', '.join(degrees)}]" if found["list"] else " to ".join(degrees)
    return f"{found[0]} ({said} deg{found['per'] or ''})"


def known(value: float | None) -> bool:
    """Return whether a value is a finite number."""
    return value is not None and math.isfinite(value)


def decimals(uncertainty: float) -> int:
    """Return the number of decimals that shows two significant digits of an uncertainty."""
    if not uncertainty > 0 or not math.isfinite(uncertainty):
        return 2
    return max(0, 1 - math.floor(math.log10(uncertainty)))


def plain(value: float | None, digits: int = 2) -> str:
    """Return text with fixed decimals and a typographic minus sign; a dash if the value is unknown."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    text = f"{value:.{digits}f}"
    return text.replace("-", MINUS) if float(text) != 0 else text.lstrip("-")


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number with significant digits in full; as a power of ten if very large or small."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    if value == 0 or _LEAST_POWER <= int(power) < _MOST_POWER:
        text = f"{float(f'{mantissa}e{power}'):.{max(0, digits - 1 - int(power))}f}"
        return _without_zeros(text).replace("-", MINUS)
    raised = str(int(power)).translate(_SUPERSCRIPT)
    return f"{_without_zeros(mantissa).replace('-', MINUS)}{_TIMES_TEN}{raised}"


def _without_zeros(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def rounded(value: float) -> str:
    """Return a number with three significant digits, at most three decimals, no exponent; a dash if unknown."""
    if not math.isfinite(value) or value == 0:
        return plain(value, 0)
    return plain(value, max(0, min(3, 2 - math.floor(math.log10(abs(value))))))


def plus_minus(value: float, half_width: float) -> tuple[str, str]:
    """Return value and half width of its interval, rounded to two digits of the half width; an empty one if unknown."""
    if not known(value):
        return "unknown", ""
    if not known(half_width):
        return significant(value, 4), ""
    digits = min(decimals(half_width), 6)
    tens = 1 - math.floor(math.log10(half_width)) if half_width >= _TWO_DIGITS else digits
    return plain(round(value, tens), digits), plain(round(half_width, tens), digits)


def interval_text(value: float, half: float) -> str:
    """Return value and half width of its interval in one text; the value alone if the interval is unknown."""
    shown, width = plus_minus(value, half)
    return f"{shown} {PLUS_MINUS} {width}" if width else shown


def with_interval(value: float, std: float, factor: float = 1.0) -> str:
    """Return value and half width of its 95 % interval in one text, both times `factor`.

    Parameters
    ----------
    value, std : float
        The quantity and its standard deviation, in one unit.
    factor : float
        To the unit that is shown.
    """
    return interval_text(factor * value, factor * half_width(std))
