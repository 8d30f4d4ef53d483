"""Options of `commission --thermal`."""

from __future__ import annotations

import click

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


def longest_warm_up_s(thermal: bool, warm_up_min: float | None, until: object | None) -> float | None:
    """Return the longest warm-up [s] of the requested thermal procedure; None if it is not requested.

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
    return 60.0 * (WARM_UP_MIN if warm_up_min is None else warm_up_min)
