"""Summary of a plan of excitation trajectories: expected standard deviations, shares of the limits, durations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.excite.excitation import Excitation
from gateway.excite.expected import AskedNumbers, LoadAsked, Purpose, arm_rows, stds_of_all
from gateway.excite.limits import KINDS, LOAD_ACCELERATION, MovingLimits, states_of
from gateway.feedforward.load import FeedLoad
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

#: Sampling period of a motion [s].
STEP_S = 0.02


def plan_summary(
    excitations: Sequence[Excitation],
    asked: Mapping[Purpose, AskedNumbers],
    limits: MovingLimits,
    load: FeedLoad,
    over_random: float | None,
) -> dict[str, Any]:
    """Return the expected standard deviations of all motions together, and the share of the limits of each.

    Parameters
    ----------
    excitations : sequence of Excitation
    asked : mapping of Purpose to AskedNumbers
    limits : MovingLimits
        Limits of the planning; shares are of these.
    load : FeedLoad
        Load for which the standard deviations are expected.
    over_random : float or None
        Expected standard deviations of the series over those of the best random one.
    """
    rows: dict[Purpose, list[Floats]] = {name: [] for name in asked}
    taken: list[dict[str, Any]] = []
    for excitation in excitations:
        states = states_of(excitation, STEP_S)
        rigid = arm_rows(limits.workspace, states)
        duration_s = excitation.periods * excitation.period_s
        for name, each in asked.items():
            rows[name].append(each.rows(states, rigid, 1, duration_s))
        taken.append(
            {"name": excitation.name, "duration_s": duration_s, "share": _shares(limits, limits.shares(states, rigid))}
        )
    noise = next(iter(asked.values())).noise
    return plain_values(
        {
            "duration_s": sum(each["duration_s"] for each in taken),
            **{name: _stds(name, each, np.concatenate(rows[name]), load) for name, each in asked.items()},
            "over_random": over_random,
            "limits": taken,
            "not_checked": list(limits.unchecked),
            "noise_nm": noise.std_nm,
            "noise_source": noise.source,
            "correlation_s": noise.correlation_s,
            "gain_std": noise.gain_std,
        }
    )


def _shares(limits: MovingLimits, share: Floats) -> dict[str, Any]:
    """Return the largest share of each kind of limit per axis; of the load where the cell limits it."""
    peak = share.max(axis=0)
    axes = limits.workspace.robot.axes
    found: dict[str, Any] = {kind: peak[k * axes : (k + 1) * axes] for k, kind in enumerate(KINDS)}
    if limits.bodies is None:
        del found["torque"]
    if np.isfinite(limits.load_acceleration_m_s2):
        found[LOAD_ACCELERATION.replace(" ", "_")] = peak[-1]
    return found


def _stds(name: Purpose, asked: AskedNumbers, rows: Floats, load: FeedLoad) -> dict[str, Any]:
    """Return the standard deviations of one purpose under the names of a result."""
    std = stds_of_all(asked, rows)
    if isinstance(asked, LoadAsked):
        about = {"mass_kg": load.mass_kg, "com_m": load.com_m, "source": load.source}
        about["inertia_kg_m2"] = load.inertia_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        about["inertia_source"] = load.inertia_source
        return {"mass_std_kg": std[0], "com_std_m": std[1:4], "inertia_std_kg_m2": std[4:], "reference": about}
    if name == "rotor":
        return {"rotor_inertia_std_kg_m2": std}
    half = len(std) // 2
    return {"coulomb_std_nm": std[:half], "viscous_std_nm_s_rad": std[half:]}
