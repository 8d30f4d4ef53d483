"""From a measured table to a load, to the effect that the model lacks, and to a page with the figures.

    python examples/python/load_and_effect.py PAGE.html

The table is of the simulated arm of `examples/large`, with a balancer that the model does not know: made by `make demo`
and `servo-gateway export out/demo/run.h5 --format csv`.
"""

import sys
from pathlib import Path

from gateway.api import ModelRequest, diagnose, estimate, read, render

HERE = Path(__file__).resolve().parent


def main(page: Path) -> None:
    """Estimate, diagnose, print both, and write the page."""
    model = ModelRequest(cell=HERE.parent / "large" / "cell.toml")
    table = HERE / "hidden_balancer.csv"
    rows = read(table, model)
    print(f"{len(rows.load)} rows, torque of J2 from {rows.tau_nm[:, 1].min():.0f} to {rows.tau_nm[:, 1].max():.0f} Nm")

    result = estimate(table, model)
    for load in result.loads:
        print(f"estimate: {load.label} {load.mass_kg:.2f} kg, standard deviation {load.mass_std_kg:.2f} kg")

    result = diagnose(table, model)
    print(f"verdict: {result.verdict}")
    for effect in result.effects:
        print(f"effect: {effect.name} of joints {list(effect.joints)}")
    for load in result.loads:
        print(f"diagnosis: {load.label} {load.mass_kg:.2f} kg, standard deviation {load.mass_std_kg:.2f} kg")
    page.write_text(render(result), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
