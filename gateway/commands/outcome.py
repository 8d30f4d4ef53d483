"""How a result is shown at the terminal, and which exit code it ends with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gateway.commands.console import Session, axis_names, axis_table, findings_table, grid, load_table
from gateway.errors import FindingFailed
from gateway.report.sentences import verdict_sentence

Json = Mapping[str, Any]
# Up to this many poses are listed, more are counted.
LISTED_POSES = 6


def show_result(body: Json, session: Session) -> None:
    """Loads, residuals, verdict, what to measure next, findings.

    Parameters
    ----------
    body : mapping
        Result JSON.
    session : Session
    """
    if body["loads"]:
        session.show(load_table(body["loads"]))
    for load in body["loads"]:
        _show_load(load, session)
    _show_residuals(body, session)
    if body.get("verdict"):
        session.show(f"verdict: {body['verdict']}. {verdict_sentence(body)}")
    for item in body.get("next") or []:
        _show_next(item, session)
    if body.get("findings"):
        session.show(findings_table(body["findings"]))


def _show_load(load: Json, session: Session) -> None:
    if load.get("refused"):
        return
    if load.get("unidentifiable"):
        session.show(f"load {load['label']}: cannot be told from these data: {', '.join(load['unidentifiable'])}")
    masses = load.get("per_pose_mass_kg") or {}
    if masses and session.verbosity > 0:
        rows = [[pose, "-" if mass is None else f"{mass:.3f}"] for pose, mass in masses.items()]
        session.show(grid(f"load {load['label']}: mass by each pose alone [kg]", ["pose", "mass"], rows))


def _show_residuals(body: Json, session: Session) -> None:
    after, before = body.get("after") or {}, body.get("before") or {}
    names = {"before": before, "after": after} if body.get("effects") else {"residual": after}
    lines = {
        name + suffix: part.get(key)
        for name, part in names.items()
        for suffix, key in (("", "rms_nm"), (", held out", "holdout_rms_nm"))
    }
    lines |= {"noise floor": body.get("noise_floor_nm"), "friction band": body.get("friction_band_nm")}
    known = {name: values for name, values in lines.items() if values and any(value is not None for value in values)}
    if known:
        session.show(axis_table("RMS [Nm]", known))


def _show_next(item: Json, session: Session) -> None:
    told = f", tells apart {', '.join(item['tells_apart'])}" if item.get("tells_apart") else ""
    share = item.get("reduction")
    gain = "" if share is None else f", standard deviation then about {100 * share:.0f} % of now"
    session.show(f"next: {item['what']}{told}{gain}")
    poses = item.get("poses_rad") or []
    if poses and len(poses) <= LISTED_POSES:
        rows = [[str(number), *(f"{math.degrees(q):.1f}" for q in q_rad)] for number, q_rad in enumerate(poses, 1)]
        session.show(grid("poses to measure [deg]", ["", *axis_names(len(poses[0]))], rows))


def fail_on_findings(body: dict[str, Any]) -> None:
    """Leave with exit code 7 when a failing finding stands."""
    failed = [finding for finding in body.get("findings") or [] if finding.get("severity") == "fail"]
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        advice = f"; {first['advice']}" if first.get("advice") else ""
        raise FindingFailed(f"finished with a failing finding: {first['where']}: {first['what']}{advice}{more}")
