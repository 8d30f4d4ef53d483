"""Arms of a cell, drawn within what its files state, measured at given poses with an effect of a wanted strength.

`servo-sim rehearse CELL` answers a request of `servo-gateway rehearse`, both JSON. The request has `table` (file to
write), `seed` of the arm, `load` (number of the load that is mounted), `q_rad` (poses), `visit_s` and `largest_kg`
(heaviest load). `link_std` and `gain_std` are the relative standard deviations of link masses and of each torque
constant. `effect` may be null; else `joints` and `strength` are given: the distance of the effect from what links,
load, constants and friction bias can take over. The answer has the truth: the load, the strength that was reached, and
the size of the effect in its own unit. A request without `table` is answered by the effects and the joints at which
they can be drawn.

Link masses, torque constants and friction of the arm are drawn from the seed; the torque constants change a little
from one load to the next.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from sim.blind import BIAS_SHARE, applies, distance, left_over, planned
from sim.build_errors import with_build_errors
from sim.cellfile import ArmSpec, CellFileError, read_cell
from sim.draw import DrawnArm, draw_load
from sim.draw_effects import MAKERS, Effect
from sim.effects import apply_effects
from sim.nominal import plant_of
from sim.offline import PlannedVisit, measure, point_jacobian
from sim.undeclared import CHANGE_S, TOOL, as_drawn

Array = NDArray[np.float64]
Request = Mapping[str, Any]

#: Standard deviation of the change of one torque constant, and of all together, from one load to the next.
CHANGE_STD, COMMON_CHANGE_STD = 0.004, 0.003
#: Relative standard deviation of a friction band about its typical level.
FRICTION_STD = 0.2
#: Draws until an effect acts on the joints wanted, or until all its joints were seen.
DRAWS = 400
AXES = 6


def answered(cell: Path, name: str | None, request: Request) -> dict[str, Any]:
    """Return the answer to a request.

    Parameters
    ----------
    cell : cell file
    name : arm of the cell; None = its only one
    request : as the text of the module says

    Raises
    ------
    CellFileError : the cell cannot be used, has no such arm, or its arm has other than six axes
    ValueError, KeyError, TypeError, OSError : the request cannot be met
    """
    arms = [arm for arm in read_cell(cell).arms if name in (None, arm.name)]
    if len(arms) != 1:
        raise CellFileError(f"{cell}: name one of its arms by --arm")
    if len(arms[0].axes) != AXES:
        raise CellFileError(f"effects are drawn for {AXES} axes; arm '{arms[0].name}' has {len(arms[0].axes)}")
    return measured(arms[0], request) if "table" in request else places(arms[0])


def places(arm: ArmSpec) -> dict[str, list[list[int]]]:
    """Joints (from 1) at which each effect can be drawn on an arm; an empty list of joints is the base or the load."""
    rng = np.random.default_rng(0)
    drawn = as_drawn(arm, plant_of(arm), {TOOL: draw_load(TOOL, 1.0, rng)})
    out: dict[str, list[list[int]]] = {}
    for name in MAKERS:
        if applies(name, drawn, two=False):
            effects = [MAKERS[name](drawn, rng)[0](0.0) for _ in range(DRAWS)]
            joints = {str(effect["joints"]): cast(list[int], effect["joints"]) for effect in effects}
            out[name] = sorted(joints.values())
    return out


def measured(arm: ArmSpec, request: Request) -> dict[str, Any]:
    """Draw an arm and a load, measure it without and with the load, write the table, and return the truth."""
    rng = np.random.default_rng([int(request["seed"]), 17])
    gain_std = np.asarray(request["gain_std"], dtype=float)
    chain = arm.chain
    plant = with_build_errors(plant_of(arm), chain, int(request["seed"]), float(request["link_std"]))
    friction = np.exp(FRICTION_STD * rng.standard_normal(AXES))
    single, common = rng.standard_normal(AXES), rng.standard_normal()
    plant = replace(
        plant,
        coulomb_nm=friction * plant.coulomb_nm,
        stiction_nm=friction * plant.stiction_nm,
        torque_constant_scale=1.0 + gain_std * math.sqrt(0.5) * (single + common),
    )
    rng = np.random.default_rng([int(request["seed"]), 19, int(request["load"])])
    load = draw_load(TOOL, float(request["largest_kg"]), rng)
    visit_s, q_rad = float(request["visit_s"]), np.asarray(request["q_rad"], dtype=float)
    loaded_s = len(q_rad) * visit_s + CHANGE_S
    drawn = replace(
        as_drawn(arm, plant, {TOOL: load}),
        shift_time_s=(loaded_s + 0.25 * len(q_rad) * visit_s, loaded_s + 0.75 * len(q_rad) * visit_s),
    )
    visits = planned(q_rad, {"none": 0.0, TOOL: loaded_s}, visit_s)
    truth: dict[str, Any] = {"load": TOOL, "mass_kg": load.mass_kg, "com_m": load.com_m.tolist(), "strength": None}
    effects: list[Effect] = []
    if request["effect"] is not None:
        effect, built = _of_strength(drawn, visits, request, gain_std)
        effects, truth = [effect], truth | built
    parts = []
    for label in ("none", TOOL):
        change = CHANGE_STD * rng.standard_normal(AXES) + COMMON_CHANGE_STD * rng.standard_normal()
        today = replace(plant, torque_constant_scale=plant.torque_constant_scale * (1.0 + change))
        today = apply_effects(today, effects, point_jacobian(chain))
        of_load = [visit for visit in visits if visit.load == label]
        parts.append(measure(chain, today, of_load, drawn.loads, drawn.protocol, rng))
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    by_axis = {"q{}_rad": "q_rad", "dir{}": "dir", "tau{}_nm": "tau_nm", "tau{}_std_nm": "tau_std_nm"}
    cells = {name: columns[name] for name in ("load", "pose", "time_s", "n")}
    cells |= {text.format(k + 1): columns[name][:, k] for text, name in by_axis.items() for k in range(AXES)}
    with Path(request["table"]).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(cells)
        writer.writerows(zip(*(values.tolist() for values in cells.values()), strict=True))
    return truth


def _of_strength(
    drawn: DrawnArm, visits: Sequence[PlannedVisit], request: Request, gain_std: Array
) -> tuple[Effect, dict[str, Any]]:
    """Return an effect near the strength wanted."""
    # a source of its own: the arm and its noise are those of the same seed without an effect
    rng = np.random.default_rng([int(request["seed"]), 23])
    name, wanted = str(request["effect"]), float(request["strength"])
    for _ in range(DRAWS):
        build, limit = MAKERS[name](drawn, rng)
        if build(limit or 0.0)["joints"] == request["joints"]:
            break
    else:
        raise ValueError(f"effect {name} does not act on joints {request['joints']}")
    if limit is None:
        return build(0.0), {}
    size, reached = 0.1 * limit, wanted
    for _ in range(3):
        size = min(limit, size * wanted / max(reached, 1e-12))
        reached = distance(left_over(drawn, visits, build(size), gain_std, BIAS_SHARE))
    ends = [cast(Mapping[str, Any], build(end)["parameters"]) for end in (0.0, limit)]
    zero, at_limit = ({key: np.asarray(value) for key, value in end.items()} for end in ends)
    grown = [key for key in zero if at_limit[key].dtype.kind == "f" and np.any(at_limit[key] != zero[key])]
    same_unit = [key for key in grown if key.rpartition("_")[2] == grown[0].rpartition("_")[2]]
    return build(size), {
        "strength": reached,
        "parameter": grown[0],
        "size": float(np.linalg.norm(np.hstack([at_limit[key] - zero[key] for key in same_unit]))) * size / limit,
        "largest_share": size / limit,
    }
