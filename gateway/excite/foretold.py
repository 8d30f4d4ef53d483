"""What a plan of motions foretells, as plain values: standard deviations, limits that are taken, duration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.excite.excitation import Excitation
from gateway.excite.expected import AskedNumbers, LoadAsked, Purpose, arm_rows, told_stds
from gateway.excite.limits import KINDS, LOAD_ACCELERATION, MovingLimits, states_of
from gateway.feedforward.load import FeedLoad
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

#: Instants at which a motion is looked at [s].
STEP_S = 0.02


def foretold(
    excitations: Sequence[Excitation],
    asked: Mapping[Purpose, AskedNumbers],
    limits: MovingLimits,
    load: FeedLoad,
    over_random: float | None,
) -> dict[str, Any]:
    """Plain values of what all motions together promise, and of what each takes of the limits.

    Parameters
    ----------
    excitations : sequence of Excitation
    asked : mapping of Purpose to AskedNumbers
    limits : MovingLimits
        As it was planned with; shares are of these.
    load : FeedLoad
        That a load's promise is made for.
    over_random : float or None
        Expected standard deviations of the series over those of the best random one.
    """
    information: dict[Purpose, Floats] = {}
    taken: list[dict[str, Any]] = []
    for excitation in excitations:
        states = states_of(excitation, STEP_S)
        rigid = arm_rows(limits.workspace, states)
        duration_s = excitation.periods * excitation.period_s
        for name, each in asked.items():
            found = each.information(states, rigid, 1, duration_s)[0]
            information[name] = information.get(name, 0.0) + found
        taken.append(
            {"name": excitation.name, "duration_s": duration_s, "share": _shares(limits, limits.shares(states, rigid))}
        )
    noise = next(iter(asked.values())).noise
    return plain_values(
        {
            "duration_s": sum(each["duration_s"] for each in taken),
            **{name: _told(name, each, told_stds(each, information[name]), load) for name, each in asked.items()},
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
    """Largest share of each kind of limit, one an axis; that of the load where the cell limits it."""
    peak = share.max(axis=0)
    axes = limits.workspace.robot.axes
    found: dict[str, Any] = {kind: peak[k * axes : (k + 1) * axes] for k, kind in enumerate(KINDS)}
    if limits.bodies is None:
        del found["torque"]
    if np.isfinite(limits.load_acceleration_m_s2):
        found[LOAD_ACCELERATION.replace(" ", "_")] = peak[-1]
    return found


def _told(name: Purpose, asked: AskedNumbers, std: Floats, load: FeedLoad) -> dict[str, Any]:
    """Standard deviations of one purpose under the names of a result."""
    if isinstance(asked, LoadAsked):
        about = {"mass_kg": load.mass_kg, "com_m": load.com_m, "source": load.source}
        about["inertia_kg_m2"] = load.inertia_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        about["inertia_source"] = load.inertia_source
        return {"mass_std_kg": std[0], "com_std_m": std[1:4], "inertia_std_kg_m2": std[4:], "reference": about}
    if name == "rotor":
        return {"rotor_inertia_std_kg_m2": std}
    half = len(std) // 2
    return {"coulomb_std_nm": std[:half], "viscous_std_nm_s_rad": std[half:]}
