"""commission --thermal: what is asked for on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from gateway.acquire.thermal import Thermal

#: Longest warm-up where none is given [min].
WARM_UP_MIN = 30.0

thermal_option = click.option(
    "--thermal", is_flag=True, help="Loads forth and back, the bare arm twice in the middle, so that drift cancels."
)
warm_up_option = click.option(
    "--warm-up",
    "warm_up_min",
    type=click.FloatRange(min=0, max=240),
    metavar="MINUTES",
    help="With --thermal: move before at most so long, until friction stands still; 30 if not given.",
)


def thermal_choice(thermal: bool, warm_up_min: float | None, until: object | None) -> Thermal | None:
    """What was asked for.

    Raises
    ------
    UsageError
        A warm-up alone, or --until beside it.
    """
    if not thermal:
        if warm_up_min is not None:
            raise click.UsageError("--warm-up belongs to --thermal")
        return None
    if until is not None:
        raise click.UsageError("--thermal measures all poses twice, --until as few as it can: give one of them")
    from gateway.acquire.thermal import Thermal

    return Thermal(60.0 * (WARM_UP_MIN if warm_up_min is None else warm_up_min))
