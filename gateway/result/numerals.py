"""Numbers with their uncertainty as text: the same on the page, at the terminal and in findings."""

from __future__ import annotations

import math
from typing import Final

from gateway.result.interval import PLUS_MINUS, half_width

MINUS: Final = "\N{MINUS SIGN}"
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
_TIMES_TEN: Final = "\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}10"
#: From here on a half width has more than two digits before the point.
_TWO_DIGITS: Final = 100.0
#: Powers of ten between which a number is written out.
_LEAST_POWER: Final = -4
_MOST_POWER: Final = 7


def known(value: float | None) -> bool:
    """Whether there is a number."""
    return value is not None and math.isfinite(value)


def decimals(uncertainty: float) -> int:
    """Decimals that show two significant digits of an uncertainty."""
    if not uncertainty > 0 or not math.isfinite(uncertainty):
        return 2
    return max(0, 1 - math.floor(math.log10(uncertainty)))


def plain(value: float | None, digits: int = 2) -> str:
    """A number with fixed decimals, a real minus sign, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    text = f"{value:.{digits}f}"
    return text.replace("-", MINUS) if float(text) != 0 else text.lstrip("-")


def significant(value: float | None, digits: int = 3) -> str:
    """A number with significant digits, written out; as a power of ten where it is very large or small."""
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
    """A number with three significant digits, none behind the third decimal and no exponent; a dash where unknown."""
    if not math.isfinite(value) or value == 0:
        return plain(value, 0)
    return plain(value, max(0, min(3, 2 - math.floor(math.log10(abs(value))))))


def plus_minus(value: float, half_width: float) -> tuple[str, str]:
    """Value and half width of its interval, by two digits of the half width; an empty one where it is unknown."""
    if not known(value):
        return "unknown", ""
    if not known(half_width):
        return significant(value, 4), ""
    digits = min(decimals(half_width), 6)
    tens = 1 - math.floor(math.log10(half_width)) if half_width >= _TWO_DIGITS else digits
    return plain(round(value, tens), digits), plain(round(half_width, tens), digits)


def interval_text(value: float, half: float) -> str:
    """Value and half width of its interval in one text; the value alone where no interval is known."""
    shown, width = plus_minus(value, half)
    return f"{shown} {PLUS_MINUS} {width}" if width else shown


def with_interval(value: float, std: float, factor: float = 1.0) -> str:
    """Value and half width of its 95 % interval in one text, both times `factor`.

    Parameters
    ----------
    value, std : float
        The quantity and its standard deviation, in one unit.
    factor : float
        To the unit that is shown.
    """
    return interval_text(factor * value, factor * half_width(std))
