"""The gateway in the benchmark: `servo-gateway estimate` by its typed functions."""

from __future__ import annotations

from benchmarks.loads.bodies import Identified
from benchmarks.naming.cells import Cell
from gateway.estimate import run
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf

AXES = ("coulomb_nm", "viscous_nm_s_rad", "rotor_inertia_kg_m2")


def identify(cell: Cell, moving: bool) -> Identified:
    """Estimate the load of a cell."""
    knowledge = Knowledge(link_std=cell.link_std, gain_std=cell.gain_std, efficiency=cell.efficiency)
    result = run(cell.table, robot_from_urdf(cell.urdf, cell.name), knowledge)
    axes = {name: tuple(float(getattr(each, name)) for each in result.motion) for name in AXES if moving}
    if "gain" in result.nuisance:
        axes["gain"] = tuple(map(float, result.nuisance["gain"].value))
    load = next((each for each in result.loads if each.label == "tool" and each.refused is None), None)
    if load is None or load.com_m is None or load.com_std_m is None:
        return Identified(None, None, axes)
    value, std = [load.mass_kg, *load.com_m], [load.mass_std_kg, *load.com_std_m]
    if load.inertia_kg_m2 is not None and load.inertia_std_kg_m2 is not None:
        value, std = [*value, *load.inertia_kg_m2], [*std, *load.inertia_std_kg_m2]
    return Identified(tuple(map(float, value)), tuple(map(float, std)), axes)
