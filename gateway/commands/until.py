"""`record --until`: measure a load pose by pose until its uncertainty is small enough."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from gateway.acquire.until import NextStep
    from gateway.acquire.until_goal import Goal


def _goal(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Goal | None:
    from gateway.acquire.until_goal import parse_until

    return None if value is None else parse_until(value)


until_option = click.option(
    "--until",
    "goal",
    metavar="mass=0.5%,com=3mm",
    callback=_goal,
    help="Choose poses during the measurement and stop when the 95 % interval of the load is this narrow (half width; "
    "kg, %, mm, m).",
)


def as_json(reason: str, decision: NextStep) -> dict[str, Any]:
    """Return how it ended as plain values; null if not requested or unknown."""
    from gateway.result.values import plain_values

    verdict = decision.verdict
    return plain_values(
        {
            "reached": bool(verdict.reached.all()),
            "reason": reason,
            "poses": verdict.poses,
            "mass_half_width_kg": float(verdict.half[0]),
            "mass_goal_kg": float(verdict.goal[0]),
            "com_half_width_m": verdict.half[1:],
            "com_goal_m": verdict.goal[1:],
        }
    )
