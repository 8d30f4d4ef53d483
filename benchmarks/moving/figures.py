"""From scored cells to the figures with their goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import HALF_WIDTH, Figures, bootstrap, figure, middle, share
from benchmarks.moving.scores import AXIS_NAMES

Floats = NDArray[np.float64]
Cell = Mapping[str, Any]

#: Intervals that hold the truth.
HOLDS = "0.93 .. 0.97"
#: An inertia is excited where the oracle has each of its six numbers to this share of the largest principal one.
EXCITED = 0.1
#: Goals of the friction curve: share of the true value.
CURVE = {"coulomb_nm": 0.03, "viscous_nm_s_rad": 0.05}
WORDS = {
    "coulomb_nm": "Coulomb friction",
    "viscous_nm_s_rad": "viscous friction",
    "rotor_inertia_kg_m2": "rotor inertia",
    "load_friction": "load friction",
    "delay_s": "delay",
}
TIER_WORDS = {"known": "gain known", "stated": "gain as stated", "ratios": "gain as ratios only", "bus": "over the bus"}


def figures(cells: Sequence[Cell]) -> Figures:
    """Figures of all cells, tier by tier."""
    out: Figures = {}
    for tier, words in TIER_WORDS.items():
        here = [cell for cell in cells if cell["tier"] == tier]
        if here:
            out |= {f"{words}: {name}": entry for name, entry in tier_figures(here, tier).items()}
    where = "over the bus: " if all(cell["tier"] == "bus" for cell in cells) else ""
    out[f"{where}impossible inertias reported"] = _count([cell["impossible"] for cell in cells], "== 0")
    out[f"{where}cells refused"] = _count([bool(cell["refused"]) for cell in cells])
    return out


def tier_figures(cells: Sequence[Cell], tier: str) -> Figures:
    """Figures of one tier: load, its stated standard deviation over the oracle's, parameters of the axes."""
    value, std, truth, oracle = (_load(cells, key) for key in ("value", "std", "truth", "oracle"))
    off = value - truth
    mass = 100.0 * np.abs(off[:, 0]) / truth[:, 0]
    out = {
        "median error of the mass": middle(mass, "<= 0.5" if tier == "known" else "printed", "% of"),
        "median error of the centre of gravity": middle(
            1000.0 * np.linalg.norm(off[:, 1:4], axis=1), "<= 1.5" if tier == "known" else "printed", "mm of"
        ),
        "median error of the inertia where excited, over the largest principal": middle(
            [worst for cell in cells if (worst := inertia_error(cell)) is not None], "<= 10", "% of"
        ),
        "inertias that are excited": share([float(excited(cell)) for cell in cells]),
        "excited inertias that were given": share([float(_has_inertia(cell)) for cell in cells if excited(cell)]),
    }
    if tier == "ratios":
        out["rms of the error of the mass"] = _rms(100.0 * off[:, 0] / truth[:, 0], "<= 3", "%")
    for words, part in (("mass", slice(0, 1)), ("centre", slice(1, 4)), ("inertia", slice(4, 10))):
        out[f"standard deviation over the oracle's, {words}"] = middle((std / oracle)[:, part].ravel().tolist())
    for name in AXIS_NAMES:
        value, std, truth, oracle = (_axes(cells, name, key) for key in ("value", "std", "truth", "oracle"))
        if not np.isfinite(value).any():
            continue
        known = np.isfinite(value) & np.isfinite(std) & np.isfinite(truth)
        share_off = np.abs(value - truth) / np.where(truth == 0.0, np.nan, np.abs(truth))
        goal = f"<= {100.0 * CURVE[name]:g}" if name in CURVE else "printed"
        words = WORDS[name]
        out[f"{words}: median error"] = middle((100.0 * share_off).tolist(), goal, "% of")
        held = np.abs(value - truth)[known] < HALF_WIDTH * std[known]
        out[f"{words}: 95 % intervals that hold the truth"] = share(held.astype(float).tolist(), HOLDS)
        out[f"{words}: standard deviation over the oracle's"] = middle((std / oracle)[known].tolist())
    return out


def excited(cell: Cell) -> bool:
    """Return whether the runs excite the inertia of the load, by the oracle; without oracle, by the result."""
    load = cell["load"]
    std = load["oracle"] if np.isfinite(load["oracle"][4:]).all() else load["std"]
    return bool(max(std[4:]) <= EXCITED * cell["largest_kg_m2"])


def inertia_error(cell: Cell) -> float | None:
    """Largest error of the six numbers over the largest principal inertia [%]; None where not excited or not given."""
    if not excited(cell) or not _has_inertia(cell):
        return None
    off = np.array(cell["load"]["value"][4:]) - np.array(cell["load"]["truth"][4:])
    return 100.0 * float(np.abs(off).max()) / cell["largest_kg_m2"]


def _has_inertia(cell: Cell) -> bool:
    return bool(np.isfinite(cell["load"]["value"][4:]).all())


def _load(cells: Sequence[Cell], key: str) -> Floats:
    return np.array([cell["load"][key] for cell in cells], dtype=float)


def _axes(cells: Sequence[Cell], name: str, key: str) -> Floats:
    return np.concatenate([np.array(cell["axes"][name][key], dtype=float) for cell in cells])


def _rms(values: Floats, goal: str, unit: str) -> dict:
    known, unit = values[np.isfinite(values)], f"{unit} of {int(np.isfinite(values).sum())}"
    if not len(known):
        return figure(float("nan"), unit=unit)
    squares = np.square(known)
    value, (low, high) = float(np.sqrt(squares.mean())), bootstrap(squares.tolist(), np.mean)
    return figure(value, goal, unit, [float(np.sqrt(low)), float(np.sqrt(high))])


def _count(hits: Sequence[float], goal: str = "printed") -> dict:
    return figure(float(np.sum(hits)), goal, f"of {len(hits)}")
