"""Options of `commission --thermal`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from gateway.acquire.thermal import Thermal

#: Default of the longest warm-up [min].
WARM_UP_MIN = 30.0

thermal_option = click.option(
    "--thermal",
    is_flag=True,
    help="Measure loads in forward and reverse order, the unloaded arm twice in the middle, so that drift cancels.",
)
warm_up_option = click.option(
    "--warm-up",
    "warm_up_min",
    type=click.FloatRange(min=0, max=240),
    metavar="MINUTES",
    help="With --thermal: longest warm-up motion, ended when friction is steady; default: 30.",
)


def thermal_choice(thermal: bool, warm_up_min: float | None, until: object | None) -> Thermal | None:
    """Return the requested thermal procedure.

    Raises
    ------
    UsageError
        --warm-up without --thermal, or --until with it.
    """
    if not thermal:
        if warm_up_min is not None:
            raise click.UsageError("--warm-up needs --thermal")
        return None
    if until is not None:
        raise click.UsageError("--thermal measures all poses twice, --until as few as possible: give one of them")
    from gateway.acquire.thermal import Thermal

    return Thermal(60.0 * (WARM_UP_MIN if warm_up_min is None else warm_up_min))
