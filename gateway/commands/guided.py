"""Command `commission`: guided commissioning."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from drives.files import replace_file
from gateway.commands.console import Session, findings_table
from gateway.commands.measure import arm_option, show_plan
from gateway.commands.motion_options import MoveChoice, move_options, stoppable
from gateway.commands.move import announce, go_with_progress
from gateway.commands.repeat import JSON_NAME, PAGE_NAME, repeat, repeat_option
from gateway.commands.result_output import fail_on_findings, show_result, write_junit
from gateway.commands.shared_options import (
    accept_options,
    bus_option,
    cell_argument,
    common,
    load_option,
    note_remarks,
    operator_option,
    refuse_unwritable,
    reserve,
    session_of,
    typed_line,
    write_json,
)
from gateway.commands.thermal import longest_warm_up_s, thermal_option, warm_up_option
from gateway.commands.until import until_option
from gateway.data.labels import BARE_LABEL
from gateway.errors import GatewayError

if TYPE_CHECKING:
    from gateway.acquire.goto import Destination
    from gateway.acquire.plan import Plan
    from gateway.acquire.session import RecordRequest
    from gateway.acquire.until import LoadSearch, NextStep
    from gateway.acquire.until_goal import Goal
    from gateway.cell.config import LoadedCell
    from gateway.data.recording.recorded import Recording
    from gateway.motion.opening import OpenArm
    from gateway.motion.stream import MoveOptions
    from gateway.result.acceptance import Expected
    from gateway.result.result import Finding, Result

#: Answers that do not confirm a prompt, after which the command ends: a program writes them, not a person.
MOST_ANSWERS: Final = 100
#: Recording in the folder of a measurement.
RECORDING: Final = "run.h5"


@click.command()
@cell_argument
@load_option("labels", "Label of a load to measure; repeatable.", multiple=True, default=("load",))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("out"), show_default=True)
@click.option("--resume", is_flag=True, help="Continue OUT/run.h5 instead of starting a new recording.")
@until_option
@thermal_option
@warm_up_option
@repeat_option
@arm_option
@accept_options
@operator_option
@bus_option
@move_options
@common
def commission(
    cell: Path,
    labels: tuple[str, ...],
    out: Path,
    resume: bool,
    goal: Goal | None,
    thermal: bool,
    warm_up_min: float | None,
    repetitions: int | None,
    arm_name: str | None,
    expected: tuple[Expected, ...],
    junit_file: Path | None,
    operator: str | None,
    bus_spec: str | None,
    moving: MoveChoice,
) -> None:
    """Guided commissioning: check, unloaded arm, each load, diagnosis, validation poses, report. The arm moves."""
    from gateway.jobs.cell_context import open_cell
    from gateway.jobs.commission import WARM_UP, Job
    from gateway.jobs.commission import commission as run
    from gateway.model.arm_model import arm_named, arm_robot
    from gateway.pipeline.accept import accept
    from gateway.report.render import render
    from gateway.result.acceptance import check_expected
    from gateway.result.result import to_dict

    _refuse_labels(labels)
    if repetitions is not None and junit_file is not None:
        raise click.UsageError("--junit holds one measurement, --repeat makes several: give one of them")
    check_expected(expected, labels)
    warm_up_s = longest_warm_up_s(thermal, warm_up_min, goal)
    context = open_cell(cell, bus_spec, reserve, moving.pacing)
    arm = arm_named(context.loaded, arm_name)
    note_remarks(arm_robot(context.loaded, arm))
    summaries = () if resume or repetitions is None else (out / JSON_NAME, out / PAGE_NAME)
    session = session_of()

    def measure(repetition: int, folder: Path) -> Result:
        """Measure into a folder, write result and report, and show them."""
        context.reserve(arm)
        recording = recording_in(folder, RECORDING, resume, context.loaded)
        result_file, page = folder / "result.json", folder / "report.html"
        written = () if resume else (recording, folder / WARM_UP, result_file, page)
        with measured_data_noted(recording, resume, "commission"), stoppable(moving) as options:
            job = Job(
                context,
                arm,
                labels,
                recording,
                options,
                operator=operator,
                goal=goal,
                warm_up_s=warm_up_s,
                repetition=repetition,
                outdated=(*written, *summaries),
            )
            result = run(job, Terminal(session, moving))
        result = accept(result, expected, arm)
        write_json(str(result_file), to_dict(result))
        replace_file(page, render(result))
        if junit_file is not None:
            write_junit(junit_file, result)
        show_result(result, session)
        session.show(f"report: {page}")
        fail_on_findings(result.findings)
        return result

    if repetitions is None:
        measure(1, out)
    else:
        repeat(repetitions, out, resume, measure)


def _refuse_labels(labels: Sequence[str]) -> None:
    """Refuse the unloaded arm among the loads, and repeated labels."""
    if BARE_LABEL in labels:
        raise click.UsageError(
            f"--load {BARE_LABEL} means the unloaded arm, which is always measured: give only the loads"
        )
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise click.UsageError(f"--load {twice} is given twice: give each load once")


@contextmanager
def measured_data_noted(recording: Path, is_continued: bool, command: str) -> Generator[None]:
    """Add to an error where the data measured until then is; a recording of an earlier job is none of it."""
    from drives.errors import DriveError

    before = recording.stat().st_ino if recording.exists() else None
    try:
        yield
    except (GatewayError, DriveError, KeyboardInterrupt, click.Abort) as error:
        if recording.exists() and (is_continued or recording.stat().st_ino != before):
            error.add_note(f"Measured data: {recording}; {command} --resume continues once the cause is gone.")
        raise


def recording_in(out: Path, name: str, resume: bool, loaded: LoadedCell) -> Path:
    """Return the recording `out`/`name`, which can be written; with `resume` one of another cell is refused.

    Raises
    ------
    InputError
    """
    from gateway.data.recording.reader import read
    from gateway.data.recording.writer import refuse_other_cell

    out.mkdir(parents=True, exist_ok=True)
    path = out / name
    refuse_unwritable(path, "--out")
    if resume and path.exists():
        refuse_other_cell(read(path), loaded.text)
    return path


@dataclass(frozen=True, slots=True)
class Terminal:
    """Dialogue at the terminal.

    Attributes
    ----------
    session : Session
    moving : MoveChoice
    refuse : callable
        Checks a plan before the drives are opened.
    """

    session: Session
    moving: MoveChoice
    refuse: Callable[[Plan], None] = lambda _plan: None

    def checked(self, items: Sequence[Finding]) -> None:
        """Show warnings and failures."""
        shown = [item for item in items if item.severity in ("warn", "fail")]
        if shown:
            self.session.show(findings_table(shown, "pre-flight check"))
        else:
            self.session.note("pre-flight check passed")

    def planned(self, plan: Plan) -> None:
        """Show the plan."""
        self.refuse(plan)
        show_plan(plan)

    def ask(self, question: str, meanwhile: Callable[[], None]) -> None:
        """Ask for permission to move."""
        self.moving.ask(question, meanwhile)

    def announced(self, opened: OpenArm, target: Destination, plan: Plan, options: MoveOptions) -> None:
        """Announce a posture to move to."""
        announce(self.session, opened, target, plan, options)

    def bring(self, opened: OpenArm, target: Destination, plan: Plan, options: MoveOptions) -> None:
        """Move there."""
        go_with_progress(self.session, opened, target, plan, options)

    def mount(self, label: str, opened: OpenArm) -> None:
        """Ask for a load, or for an empty flange; its label or `yes` confirms it, typed after the prompt.

        At a terminal the drives are read once a second meanwhile; what has changed ends the prompt.
        """
        do = "Remove everything from the flange" if label == BARE_LABEL else f"Mount load '{label}' on the flange"
        answer = f"type {label} or yes, and press Enter"
        state = opened.group.gate(full=True)
        state.require_approach()
        self.session.note(f"Arm '{opened.config.name}': {state}. {do}, then {answer}.")
        prompt = f"HANG LOAD {label}\n"
        for _ in range(MOST_ANSWERS):
            line = typed_line(prompt, opened.group.attend, err=False)
            if line == label or line.lower() == "yes":
                return
            self.session.note(f"This does not confirm it: once it is done, {answer}.", -1)
            prompt = ""
        raise click.Abort

    def measure(self, opened: OpenArm, plan: Plan, request: RecordRequest, options: MoveOptions) -> None:
        """Record with a progress bar."""
        from gateway.commands.progress import recording_with_progress

        recording_with_progress(self.session, opened, plan, request, options)

    def measure_until(
        self, opened: OpenArm, search: LoadSearch, earlier: Recording | None, path: Path, options: MoveOptions
    ) -> NextStep:
        """Record pose by pose with a progress bar; return the last decision."""
        from gateway.commands.progress import recording_until

        return recording_until(self.session, opened, search, path, earlier, options)[1]

    def say(self, text: str) -> None:
        """Print a note."""
        self.session.note(text)
