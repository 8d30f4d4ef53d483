"""Terminal output of a result, and the exit code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from drives.files import replace_file
from gateway.commands.console import Session, axis_names, axis_table, findings_table, grid, load_table, number
from gateway.errors import FindingFailed
from gateway.result.names import INERTIA_WHOLE
from gateway.result.numerals import SAID

if TYPE_CHECKING:
    from gateway.result.result import Finding, LoadResult, Result

# Up to this many poses are listed; more are counted.
LISTED_POSES = 6
ACCEPTANCE_COLUMNS = ("load", "measured", "allowed", "outcome")


def show_result(result: Result, session: Session) -> None:
    """Show loads, residuals, verdict, poses to measure next, and findings."""
    from gateway.report.view import VERDICTS, formula_rows, formula_text, verdict_text
    from gateway.result.acceptance import IN_WORDS, asked_for, measured

    if result.loads:
        session.show(load_table(result))
    for load in result.loads:
        _show_load(load, session)
    _show_motion(result, session)
    models = {"before": result.before, "after": result.after} if result.effects else {"residual": result.after}
    lines = {}
    for name, model in models.items():
        lines |= {name: model.rms_nm, f"{name}, held out": model.holdout_rms_nm}
    lines |= {"noise floor": result.noise_floor_nm, "friction band": result.friction_band_nm}
    known = {name: values for name, values in lines.items() if any(map(math.isfinite, values))}
    if known:
        session.show(axis_table("RMS [Nm]", known))
    if result.verdict:
        session.show(f"verdict: {VERDICTS[result.verdict]} ({result.verdict}). {verdict_text(result)}")
    if result.formula is not None:
        session.show(formula_text(result.formula))
        rows = [
            [product, value if not half else f"{value} ± {half}", unit]
            for product, value, half, unit in formula_rows(result.formula)
        ]
        session.show(grid("torque that the model lacks, sum of", ["product", "coefficient (95 %)", "unit"], rows))
    for item in result.next:
        separates = f", separates {', '.join(item.tells_apart)}" if item.tells_apart else ""
        known_next = math.isfinite(item.reduction)
        gain = f", reduces the interval to about {100 * item.reduction:.0f} %" if known_next else ""
        session.show(f"next: {item.what}{separates}{gain}")
        if item.poses_rad and len(item.poses_rad) <= LISTED_POSES:
            next_rows = [
                [str(count), *(f"{math.degrees(q):.1f}" for q in q_rad)]
                for count, q_rad in enumerate(item.poses_rad, 1)
            ]
            session.show(grid("poses to measure [deg]", ["", *axis_names(len(item.poses_rad[0]))], next_rows))
    if result.acceptance:
        acceptance_rows = [
            [row.load, f"{row.what} {measured(row)}", asked_for(row), IN_WORDS[row.outcome]]
            for row in result.acceptance
        ]
        session.show(
            grid(f"acceptance: value ± half of the {SAID} interval", ACCEPTANCE_COLUMNS, acceptance_rows, left=4)
        )
    if result.findings:
        session.show(findings_table(result.findings))


def _show_load(load: LoadResult, session: Session) -> None:
    if load.refused:
        return
    open_ = [name for name in load.unidentifiable if name != INERTIA_WHOLE]  # not expected from rest poses
    if open_:
        session.show(f"load {load.label}: not identifiable from these data: {', '.join(open_)}")
    if load.per_pose_mass_kg and session.verbosity > 0:
        rows = [[pose, number(mass, 3)] for pose, mass in load.per_pose_mass_kg.items()]
        session.show(grid(f"load {load.label}: mass from each pose alone [kg]", ["pose", "mass"], rows))


def _show_motion(result: Result, session: Session) -> None:
    """Show inertia of the loads, and friction and rotor inertia of the axes, if identified from motion."""
    from gateway.report.moving_section import PARTS, axis_rows, inertia_view

    found = [(load.label, inertia) for load in result.loads if (inertia := inertia_view(load)) is not None]
    if found:
        frame = found[0][1].frame
        title = f"inertia about the centre of gravity, axes of {frame} [kg m2]: value ± half of the {SAID} interval"
        rows = [
            [label, *(f"{value} ± {half}" if half else value for _, value, half in inertia.parts)]
            for label, inertia in found
        ]
        session.show(grid(title, ["load", *PARTS], rows))
    axes = max((axis.joint for axis in result.motion), default=0)
    separates = axis_rows(result.motion, axes)
    if separates:
        rows = [[said, *cells] for said, cells in separates]
        session.show(
            grid(f"identified from motion: value ± half of the {SAID} interval", ["", *axis_names(axes)], rows)
        )


def write_junit(path: Path, result: Result) -> None:
    """Write the acceptance result as JUnit XML."""
    from gateway.result.junit import junit

    replace_file(path, junit(result, datetime.now(UTC)))


def fail_on_findings(findings: Sequence[Finding]) -> None:
    """Exit with code 7 on a failing finding."""
    failed = [finding for finding in findings if finding.severity == "fail"]
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        advice = f"; {first.advice}" if first.advice else ""
        raise FindingFailed(f"finished with a failing finding: {first.where}: {first.what}{advice}{more}")
