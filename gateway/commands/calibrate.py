"""calibrate: torque constants from a weighed load, guided or from recordings, stored beside the cell file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from gateway.commands.console import findings_table, grid
from gateway.commands.guided import measured_data_noted
from gateway.commands.measure import arm_option
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.result_output import fail_on_findings
from gateway.commands.shared_options import (
    KNOWN_FORM,
    KNOWN_HELP,
    bus_option,
    cell_argument,
    cell_context,
    common,
    json_option,
    measurement_options,
    refuse_unwritable,
    session_of,
    warm_option,
    write_json,
)
from gateway.data.labels import label_refused

#: Recording in the folder of -o.
_RECORDING: Final = "calibrate.h5"


@click.command()
@cell_argument
@click.option("--known", required=True, metavar=KNOWN_FORM, help=f"The weighed load. {KNOWN_HELP}")
@measurement_options("with the unloaded arm and the load", _RECORDING)
@warm_option
@click.option("--force", is_flag=True, help="Store the calibration although a finding fails.")
@arm_option
@bus_option
@json_option
@move_options
@common
def calibrate(
    cell: Path,
    known: str,
    data: tuple[Path, ...],
    is_warm: bool,
    force: bool,
    out: Path,
    resume: bool,
    arm_name: str | None,
    bus_spec: str | None,
    json_out: str | None,
    moving: MoveChoice,
) -> None:
    """Calibrate torque constants with a weighed load: unloaded, mounted, unloaded. The arm moves, except with --from.

    The result is stored beside the cell file as CELL.calibration.toml; estimate, diagnose and commission use it.

    \b
    Examples:
      servo-gateway calibrate cell.toml --known weight=20.00+-0.01,0,0,0.15
      servo-gateway calibrate cell.toml --known weight=20.00 --from run.h5
    """
    from gateway.cell.calibration import calibration_path
    from gateway.commands.terminal import terminal
    from gateway.jobs.calibrate import calibrate as run
    from gateway.jobs.calibrate import store_calibration
    from gateway.pipeline.known import parse_known
    from gateway.result.values import plain_values

    label, stated = parse_known(known)
    wrong = label_refused(label)
    if wrong:
        raise click.UsageError(f"--known {label}: '{label}' {wrong}")
    context, session, path = cell_context(cell, bus_spec, moving.pacing), session_of(), calibration_path(cell)
    if not stated.mass_std_kg:
        session.note(f"{stated.mass_kg:g} kg count as exact; state the scale's uncertainty: --known {label}=MASS+-STD")
    refuse_unwritable(path, "calibration file")
    recording = out / _RECORDING
    if not data:
        refuse_unwritable(recording, "-o")
    with measured_data_noted(recording, resume, "calibrate"), stoppable(moving) as options:
        calibration = run(
            context,
            label,
            stated,
            terminal(session, moving),
            options,
            recording=recording,
            data=data,
            arm=arm_name,
            is_warm=is_warm,
            resume=resume,
        )
    new = calibration.stored
    findings = store_calibration(context, calibration, force=force)
    is_stored = all(each.severity != "fail" for each in findings)
    axes = [plain_values(axis) for axis in calibration.axes]
    report = {"axes": axes, "findings": [plain_values(each) for each in findings]}
    write_json(json_out, {"schema": 1, "arm": new.name, "load": new.load, "mass_kg": new.mass_kg, **report})
    rows = [
        [
            f"J{axis.joint}",
            "-" if axis.constant_nm_per_a is None else f"{axis.constant_nm_per_a:.4g}",
            f"{axis.scale:.4f}",
            f"{100 * axis.std:.2f}",
            f"{100 * axis.stated_std:.3g}",
            f"{axis.deviation:+.1f}",
            "yes" if axis.is_known and is_stored else "no",
        ]
        for axis in calibration.axes
    ]
    columns = ["axis", "Nm/A", "true/stated", "std [%]", "stated to [%]", "difference [std]", "stored"]
    session.show(grid(f"torque constants, from load {new.load} of {new.mass_kg:.6g} kg", columns, rows))
    if findings:
        session.show(findings_table(findings))
    if is_stored:
        session.show(f"{path}: stored; estimate, diagnose and commission use it with this cell")
    fail_on_findings(findings)
