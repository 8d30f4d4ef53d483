"""servo-sim: simulated arms and drives on a CAN bus."""

from __future__ import annotations

import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from sim.cellfile import PACINGS

FILE_ERROR, BUS_ERROR = 3, 4


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="servo-gateway", prog_name="servo-sim")
def main() -> None:
    """Simulated arms and drives on a CAN bus."""


@main.command()
@click.argument("cell", type=click.Path(path_type=Path))
@click.option("--bus", metavar="SPEC", help="INTERFACE:CHANNEL[,key=value]... in place of the cell's bus.")
@click.option("--payload", type=click.Path(path_type=Path), help="Loads: [[load]] label, mass_kg, com_m.")
@click.option("--undeclared", type=click.Path(path_type=Path), help="Effects: [[effect]] name, joints, parameters.")
@click.option("--seed", type=click.IntRange(min=0), help="Draw undeclared effects from this seed.")
@click.option(
    "--fault",
    multiple=True,
    metavar="NAME",
    help="Fault: [NODE:]NAME, or a file of [[fault]] kind, node, at_sync; repeatable.",
)
@click.option("--noise-seed", type=click.IntRange(min=0), hidden=True)
@click.option("--truth", type=click.Path(path_type=Path), help="Write the truth here at start.")
@click.option("--pacing", type=click.Choice(PACINGS), help="Instead of the cell's: by SYNC, or in real time.")
@click.option("--posture", metavar="J1,J2,..", help="Joint angles [rad] at the start; default: zeros.")
@click.option(
    "--unbuffered",
    is_flag=True,
    help="In real time: apply each target on arrival instead of at the drive's own clock tick.",
)
@click.option("--timing", type=click.Path(path_type=Path), help="Write frames and motion of the drives here.")
def serve(cell: Path, **options: Any) -> None:
    """Serve the drives of CELL until Ctrl-C. On stdin: payload LABEL | none, grip open | closed, quit."""
    with _installed():
        from sim.serve import ServeOptions, SimulationBusError
        from sim.serve import serve as run

    if None not in (options["undeclared"], options["seed"]):
        raise click.UsageError("--undeclared and --seed exclude each other.")
    try:
        run(cell, ServeOptions(**options), lambda line: print(line, flush=True))
    except (ValueError, OSError) as error:
        print(f"servo-sim: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(BUS_ERROR if isinstance(error, SimulationBusError) else FILE_ERROR)


@main.command()
@click.argument("cell", type=click.Path(path_type=Path))
@click.option("--arm", metavar="NAME", help="Arm of the cell, if it has several.")
def rehearse(cell: Path, arm: str | None) -> None:
    """Measure an arm drawn within the statements of CELL: the request comes on stdin as JSON, the truth on stdout."""
    from sim.rehearsal import answered

    try:
        print(json.dumps(answered(cell, arm, json.load(sys.stdin))))
    except (ValueError, KeyError, TypeError, OSError) as error:
        print(f"servo-sim: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(FILE_ERROR)


@main.command(add_help_option=False, context_settings={"ignore_unknown_options": True})
@click.argument("options", nargs=-1, type=click.UNPROCESSED)
def demo(options: tuple[str, ...]) -> None:
    """Commission a simulated cell with an undeclared effect: `servo-sim demo -o FOLDER`."""
    with _installed():
        from sim.demo import main as run
    run.main(list(options), prog_name="servo-sim demo")


@contextmanager
def _installed() -> Generator[None]:
    """Exit with the install command if a package of the extra `sim` is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        print(f"servo-sim: {error.name} is not installed: pip install 'servo-gateway[sim]'", file=sys.stderr)
        sys.exit(FILE_ERROR)


if __name__ == "__main__":
    main()
