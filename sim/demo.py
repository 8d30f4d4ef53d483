"""Run a complete commissioning on the simulator: `python -m sim.demo -o out/demo`.

Two programs in two processes on a free bus: the simulated drives, and the gateway, which commissions the cell. When the
gateway requests a load, it is mounted. The arm has a balancer that its model lacks (or effects drawn from a seed). At
the end the simulator's truth is compared with the estimate.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click

from sim.cellfile import read_payloads
from sim.serve import RunningSimulation, running

EXAMPLE = Path(__file__).parent / "example"
LOAD_PROMPT = re.compile(r"HANG LOAD (\S+)")
FAILED_FINDING = 7
#: Both programs wait for each other instead of the clock: the whole job in a fraction of its time.
PACING = "lockstep"


@click.command()
@click.option("--cell", type=click.Path(exists=True, path_type=Path), default=EXAMPLE / "cell.toml")
@click.option("--payload", type=click.Path(exists=True, path_type=Path), default=EXAMPLE / "payload.toml")
@click.option(
    "--undeclared", type=click.Path(exists=True, path_type=Path), help="File of undeclared effects [a balancer spring]."
)
@click.option("--seed", type=click.IntRange(min=0), help="Draw the undeclared effects from this seed instead.")
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True)
def main(cell: Path, payload: Path, undeclared: Path | None, seed: int | None, out: Path) -> None:
    """Commission a simulated cell with an undeclared effect, from the first frame to the report."""
    if seed is None:
        undeclared = undeclared or EXAMPLE / "undeclared.toml"
    elif undeclared is not None:
        raise click.UsageError("--undeclared and --seed exclude each other.")
    sys.exit(run(cell, payload, undeclared, seed, out))


def run(cell: Path, payload: Path, undeclared: Path | None, seed: int | None, out: Path) -> int:
    """Run simulator and gateway; return the exit code of the gateway.

    Parameters
    ----------
    cell, payload, undeclared, seed : as of `servo-sim serve`
    out : folder of the results
    """
    out.mkdir(parents=True, exist_ok=True)
    truth, begun = out / "truth.json", time.monotonic()
    with running(cell, payload=payload, undeclared=undeclared, seed=seed, truth=truth, pacing=PACING) as simulator:
        click.echo(simulator.ready)
        words = [sys.executable, "-m", "gateway.cli", "commission", str(cell)]
        words += ["--bus", simulator.bus, "--pacing", PACING, "--yes", "-o", str(out)]
        for label in read_payloads(payload):
            words += ["--load", label]
        code = _commission(words, simulator)
    result = out / "result.json"
    if code in (0, FAILED_FINDING) and result.exists():
        _add_truth(result, json.loads(truth.read_text(encoding="utf-8")))
        _print_comparison(json.loads(result.read_text(encoding="utf-8")))
    truth.unlink(missing_ok=True)
    click.echo(f"{time.monotonic() - begun:.1f} s; results in {out}")
    return code


def _commission(words: list[str], simulator: RunningSimulation) -> int:
    """Run the gateway, show its output, mount the loads that it requests."""
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as gateway:
        if gateway.stdout is None or gateway.stdin is None:
            return 1
        for line in gateway.stdout:
            click.echo(line.rstrip("\n"))
            asked = LOAD_PROMPT.search(line)
            if asked:
                click.echo(simulator.ask(f"payload {asked.group(1)}"))
                gateway.stdin.write(f"{asked.group(1)}\n")
                gateway.stdin.flush()
        return gateway.wait()


def _add_truth(path: Path, truth: dict[str, Any]) -> None:
    result = json.loads(path.read_text(encoding="utf-8"))
    result["truth"] = truth
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def comparison(result: dict[str, Any]) -> list[str]:
    """Return the lines of a table: truth, estimate, error, and error divided by its standard uncertainty."""
    lines = [f"{'':16}{'truth':>10}{'estimate':>10}{'error':>9}{'std':>8}{'error/std':>11}"]
    known = {load["label"]: load for load in result["truth"]["loads"]}
    for load in result["loads"]:
        true = known.get(load["label"])
        if true is None or load.get("mass_kg") is None:
            continue
        rows = [("mass [kg]", 1.0, true["mass_kg"], load["mass_kg"], load["mass_std_kg"])]
        for axis, was, is_, std in zip("xyz", true["com_m"], load["com_m"], load["com_std_m"], strict=True):
            rows.append((f"com {axis} [mm]", 1e3, was, is_, std))
        lines += [_row(f"{load['label']} {name}", *figures) for name, *figures in rows]
    named, found = (
        ", ".join(str(effect["name"]) for effect in effects) or "none"
        for effects in (result["truth"]["effects"], result.get("effects", []))
    )
    lines.append(f"undeclared effects: {named}; found: {found}; verdict: {result.get('verdict')}")
    residual = [(result.get(when) or {}).get("holdout_rms_nm") or [] for when in ("before", "after")]
    if result.get("effects") and all(residual):
        pairs = [(old, new) for old, new in zip(*residual, strict=True) if old is not None and new is not None]
        lines.append("held-out RMS [Nm], before > after: " + ", ".join(f"{old:.4g} > {new:.4g}" for old, new in pairs))
    return lines


def _row(name: str, factor: float, true: float, found: float | None, std: float | None) -> str:
    if found is None or std is None:
        return f"{name:16}{factor * true:10.2f}{'not identifiable':>20}"
    error = found - true
    figures = f"{factor * true:10.2f}{factor * found:10.2f}{factor * error:9.2f}{factor * std:8.2f}"
    return f"{name:16}{figures}{error / std if std else 0.0:11.2f}"


def _print_comparison(result: dict[str, Any]) -> None:
    click.echo("\nTruth (known to the simulator alone) against the estimate:")
    for line in comparison(result):
        click.echo("  " + line)


if __name__ == "__main__":
    main()
