"""commission: all of it, guided."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commands.measure import arm_option, show_plan
from gateway.commands.options import (
    bus_option,
    cell_argument,
    common,
    confirm,
    session_of,
    stop_on_termination,
    write_json,
    write_text,
    yes_option,
)
from gateway.console import Session, findings_table
from gateway.errors import FindingFailed, GatewayError

if TYPE_CHECKING:
    from gateway.acquire.opening import OpenArm
    from gateway.acquire.plan import Plan
    from gateway.acquire.session import RecordRequest
    from gateway.check_rules import CheckItem


@click.command()
@cell_argument
@click.option(
    "--load", "labels", multiple=True, metavar="LABEL", default=("load",), help="Load to ask for; repeatable."
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("out"), show_default=True)
@click.option("--resume", is_flag=True, help="Go on with OUT/run.h5 instead of starting a new one.")
@arm_option
@bus_option
@yes_option
@common
def commission(
    cell: Path,
    labels: tuple[str, ...],
    out: Path,
    resume: bool,
    arm_name: str | None,
    bus_spec: str | None,
    yes: bool,
) -> None:
    """All of it, guided: check, bare arm, each load, diagnosis, fresh poses, report. The arm moves."""
    from drives.errors import DriveError
    from gateway.arm_model import arm_named
    from gateway.cell_context import open_cell
    from gateway.commission import Job
    from gateway.commission import commission as run
    from gateway.handover import as_json
    from gateway.report.render import render

    context = open_cell(cell, bus_spec)
    arm = arm_named(context.loaded, arm_name)
    out.mkdir(parents=True, exist_ok=True)
    recording = out / "run.h5"
    if not resume:
        _set_aside(recording, session_of())
    job = Job(context, arm, labels, recording)
    try:
        with stop_on_termination():
            result = run(job, _Terminal(session_of(), context.loaded.cell.name, yes))
    except (GatewayError, DriveError, KeyboardInterrupt) as error:
        if recording.exists():
            error.add_note(f"What was measured is in {recording}; go on with commission --resume.")
        raise
    body = as_json(result)
    write_json(str(out / "result.json"), body)
    write_text(out / "report.html", render(body))
    show_result(body, session_of())
    session_of().show(f"report: {out / 'report.html'}")
    fail_on_findings(body)


def _set_aside(path: Path, session: Session) -> None:
    """Keep an earlier recording under another name."""
    if not path.exists():
        return
    number = next(index for index in range(1, 10_000) if not path.with_suffix(f".{index}.h5").exists())
    path.rename(path.with_suffix(f".{number}.h5"))
    session.note(f"{path} is kept as {path.with_suffix(f'.{number}.h5')}")


@dataclass(frozen=True, slots=True)
class _Terminal:
    """The person at the terminal."""

    session: Session
    cell: str
    yes: bool

    def checked(self, items: Sequence[CheckItem]) -> None:
        """Show what is wrong."""
        shown = [item.as_json() for item in items if item.severity in ("warn", "fail")]
        if shown:
            self.session.show(findings_table(shown, "pre-flight check"))
        else:
            self.session.note("pre-flight check: nothing to complain about")

    def planned(self, plan: Plan) -> None:
        """Show the plan and ask."""
        show_plan(plan)
        confirm(f"Arm '{plan.arm}' of cell '{self.cell}' will move. Is nobody near it?", yes=self.yes)

    def hang(self, label: str) -> None:
        """Ask for a load; a line on stdin says that it hangs."""
        self.session.note("The arm is in its brakes. Hang the load, then press Enter.")
        click.echo(f"HANG LOAD {label}")
        if not sys.stdin.readline():
            raise click.Abort

    def measure(self, opened: OpenArm, plan: Plan, request: RecordRequest) -> None:
        """Record with a progress bar."""
        from gateway.progress import recording_with_progress

        recording_with_progress(self.session, opened, plan, request)

    def say(self, text: str) -> None:
        """A remark."""
        self.session.note(text)


def show_result(body: dict[str, Any], session: Session) -> None:
    """Loads, residuals, verdict and findings of a result."""
    from gateway.console import axis_table, load_table
    from gateway.report.sentences import verdict_sentence

    if body["loads"]:
        session.show(load_table(body["loads"]))
    after, before = body.get("after") or {}, body.get("before") or {}
    lines = {"noise floor": body.get("noise_floor_nm"), "friction band": body.get("friction_band_nm")}
    if body.get("effects"):
        lines = {"before": before.get("rms_nm"), "before, held out": before.get("holdout_rms_nm")} | {
            "after": after.get("rms_nm"),
            "after, held out": after.get("holdout_rms_nm"),
        } | lines  # fmt: skip
    else:
        lines = {"residual": after.get("rms_nm"), "held out": after.get("holdout_rms_nm")} | lines
    known = {name: values for name, values in lines.items() if values and any(value is not None for value in values)}
    session.show(axis_table("RMS [Nm]", known))
    if body.get("verdict"):
        session.show(f"verdict: {body['verdict']}. {verdict_sentence(body)}")
    for item in body.get("next") or []:
        told = f" (tells apart: {', '.join(item['tells_apart'])})" if item.get("tells_apart") else ""
        poses = f", {len(item['poses_rad'])} poses" if item.get("poses_rad") else ""
        session.show(f"next: {item['what']}{poses}{told}")
    if body.get("findings"):
        session.show(findings_table(body["findings"]))


def fail_on_findings(body: dict[str, Any]) -> None:
    """Leave with exit code 7 when a failing finding stands."""
    failed = [finding for finding in body.get("findings") or [] if finding.get("severity") == "fail"]
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        advice = f"; {first['advice']}" if first.get("advice") else ""
        raise FindingFailed(f"finished with a failing finding: {first['where']}: {first['what']}{advice}{more}")
