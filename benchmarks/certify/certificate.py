"""Expanded uncertainty of a certificate against a Monte Carlo of everything that its budget names (JCGM 101)."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.cell_file import invoked, write_cell_file
from benchmarks.conflict.answers import write_cell
from benchmarks.conflict.arm import AXES, LINK_STD, scattered
from benchmarks.conflict.plant import GAIN_STD, draw_cell, measure

#: The arm, its load and its poses are those of this seed in every draw.
ARM = 3


def drawn_mass(seed: int) -> dict:
    """Draw constants, links, friction and noise, measure, estimate: error of the mass, and U of the certificate."""
    from gateway.result.certificate import certificate
    from gateway.result.result import read_result

    drawn = draw_cell(ARM)
    drawn.rng, rng = np.random.default_rng([seed, 21]), np.random.default_rng([seed, 22])
    common, own = rng.standard_normal(), rng.standard_normal(AXES)
    drawn.gain = GAIN_STD * (common + own) / np.sqrt(2.0)
    drawn.true = scattered(rng, drawn.arm.geometry, drawn.stated, LINK_STD)
    drawn.friction.bias_nm = 0.1 * drawn.friction.coulomb_nm * rng.standard_normal(AXES)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_cell_file(folder, drawn.arm.rated_kg, drawn.arm.geometry.limit_rad, 10.0 * drawn.size_nm)
        drawn.columns = measure(drawn)
        table, _ = write_cell(drawn, folder)
        answer = folder / "result.json"
        code, said = invoked("estimate", table, "--warm", "--cell", folder / "cell.toml", "--json", answer)
        if not answer.exists():
            return {"seed": seed, "error_kg": None, "said": f"{code} {said[-200:]}"}
        (load,) = certificate(read_result(answer)).loads
    if load.refused:
        return {"seed": seed, "error_kg": None, "said": load.refused}
    mass = load.quantities[0]
    return {"seed": seed, "error_kg": mass.value - float(drawn.loads["tool"][0]), "expanded_kg": mass.expanded}


def certificate_figures(draws: list[dict]) -> dict[str, dict]:
    """Ratio of the expanded uncertainty and the Monte Carlo's interval, with the error of the Monte Carlo."""
    from benchmarks.figure import figure

    known = [draw for draw in draws if draw["error_kg"] is not None]
    error = np.array([draw["error_kg"] for draw in known])
    expanded = float(np.median([draw["expanded_kg"] for draw in known]))
    low, high = np.quantile(error, [0.025, 0.975])
    ratio = 2.0 * expanded / float(high - low)
    rng = np.random.default_rng(0)
    again = np.quantile(rng.choice(error, (1000, len(error))), [0.025, 0.975], axis=1)
    spread = np.quantile(2.0 * expanded / (again[1] - again[0]), [0.025, 0.975])
    off = figure(100.0 * abs(ratio - 1.0), "<= 5", "%")
    return {
        f"certificate: U of the mass off the Monte Carlo of {len(known)} draws": off,
        "certificate: U over half the 95 % interval of the draws": {
            "value": ratio,
            "interval": spread.tolist(),
            "unit": "",
            "goal": "printed",
            "met": None,
        },
    }
