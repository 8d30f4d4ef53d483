"""The person at the terminal as the operator of a job: questions, prompts to mount a load, plans and progress."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Final

import click

from gateway.acquire.events import (
    Event,
    Listener,
    Narrowed,
    PeriodDone,
    PoseDone,
    Progress,
    SampleRepeated,
    Started,
    StateChanged,
    VisitDone,
)
from gateway.acquire.passes import Pass
from gateway.acquire.plan import Plan
from gateway.acquire.until import LoadSearch
from gateway.commands.console import Bar, Session, axis_names, findings_table, grid
from gateway.commands.motion_options import MoveChoice, support_asked
from gateway.commands.plan_moving import show_assumed
from gateway.commands.shared_options import typed_line
from gateway.data.labels import BARE_LABEL
from gateway.jobs.frame import Operator
from gateway.motion.opening import OpenArm
from gateway.result.finding import Finding
from gateway.result.numerals import SAID

#: Answers that do not confirm a prompt, after which the command ends: a program writes them, not a person.
MOST_ANSWERS: Final = 100


class ProgressListener:
    """Observer of a run that updates a progress bar.

    Parameters
    ----------
    session : Session
    bar : Bar
        Length: planned duration of the motion [s].
    """

    def __init__(self, session: Session, bar: Bar) -> None:
        self._session, self._bar = session, bar
        self._visits = self._done = 0

    def __call__(self, event: Event) -> None:
        """Show one event."""
        if isinstance(event, Started):
            self._visits = event.visits
        elif isinstance(event, Progress):
            self._bar.set(event.elapsed_s, event.elapsed_s + event.remaining_s, event.what)
        elif isinstance(event, VisitDone):
            self._done += 1
            side = "from below" if event.direction > 0 else "from above"
            self._session.note(f"visit {self._done}/{self._visits}: pose {event.pose} {side}", level=1)
        elif isinstance(event, PoseDone):
            band = " ".join(f"{value:.2g}" for value in event.friction_band_nm)
            self._session.note(f"pose {event.pose}, load {event.load}: friction band {band} Nm", level=1)
        elif isinstance(event, SampleRepeated):
            axes = ", ".join(f"J{axis}" for axis in event.axes)
            self._session.note(f"SYNC {event.sync_index} not answered by {axes}; sample repeated")
        elif isinstance(event, Narrowed):
            self._session.note(f"load {event.load}, {event.text}")
        elif isinstance(event, PeriodDone):
            self._report_period(event)
        elif isinstance(event, StateChanged):
            self._session.note(str(event.state), level=2)
        else:
            # the raised error repeats it at the end of the output
            self._session.note(f"stopped: {event.reason}", level=1)

    def _report_period(self, event: PeriodDone) -> None:
        """Report every period with a missing SYNC; only complete periods count."""
        speed = f" at {event.speed:.0%}" if event.speed != 1.0 else ""
        name, lost = f"'{event.name}' number {event.period}{speed}", event.incomplete_epochs
        if event.complete:
            self._done += 1
            self._session.note(f"period {self._done}/{self._visits}: {name}", level=1)
        elif lost:
            self._session.note(f"{name}: {lost} SYNCs not answered")
        else:
            self._session.note(f"{name}: cut short", level=1)


def terminal(session: Session, moving: MoveChoice) -> Operator:
    """Return the person at the terminal; with --yes no question about motion is asked, and no plan is shown for it."""

    def mount(label: str, opened: OpenArm) -> None:
        """Ask for a load, or for an empty flange; its label or `yes` confirms it, typed after the prompt.

        At a terminal the drives are read once a second meanwhile; what has changed ends the prompt.
        """
        do = "Remove everything from the flange" if label == BARE_LABEL else f"Mount load '{label}' on the flange"
        answer = f"type {label} or yes, and press Enter"
        state = opened.group.gate(full=True)
        state.require_approach()
        session.note(f"Arm '{opened.config.name}': {state}. {do}, then {answer}.")
        prompt = f"HANG LOAD {label}\n"
        for _ in range(MOST_ANSWERS):
            line = typed_line(prompt, opened.group.attend, err=False)
            if line == label or line.lower() == "yes":
                return
            session.note(f"This does not confirm it: once it is done, {answer}.", -1)
            prompt = ""
        raise click.Abort

    def planned(arm: str, plan: Plan | LoadSearch | Sequence[Pass]) -> None:
        if isinstance(plan, Plan):
            show_plan(session, plan)
        elif isinstance(plan, LoadSearch):
            session.show(
                f"load {plan.label} is measured pose by pose, each approached from both directions, until "
                f"{plan.goal} ({SAID}); each pose is the one of {len(plan.pool_rad)} postures and their neighbours "
                "with the most expected information per second"
            )
        else:
            _show_passes(session, arm, plan)

    def checked(findings: Sequence[Finding]) -> None:
        shown = [item for item in findings if item.severity in ("warn", "fail")]
        if shown:
            session.show(findings_table(shown, "pre-flight check"))
        else:
            session.note("pre-flight check passed")

    @contextmanager
    def progress(total_s: float, name: str) -> Generator[Listener]:
        with session.progress(total_s, name) as bar:
            yield ProgressListener(session, bar)

    return Operator(
        ask=moving.ask,
        mount=mount,
        support=support_asked(moving),
        say=session.note,
        planned=planned if not moving.yes else lambda _arm, _plan: None,
        checked=checked,
        progress=progress,
        working=session.working,
    )


def _show_passes(session: Session, arm: str, passes: Sequence[Pass]) -> None:
    rows = [
        [
            one.excitation.name,
            "all" if one.excitation.joint == 0 else f"J{one.excitation.joint}",
            str(len(one.periods)),
            f"{one.motion.duration_s:.1f}",
            f"{one.speed:.0%}",
        ]
        for one in passes
    ]
    session.show(grid(f"arm {arm}: motions", ["motion", "joints", "periods", "each [s]", "speed"], rows, left=2))
    minutes = math.fsum(one.duration_s for one in passes) / 60
    rate = f", {1.0 / passes[0].motion.period_s:.0f} SYNCs per second" if passes else ""
    session.show(f"about {minutes:.1f} min of motion plus transfer motions{rate}")


def show_plan(session: Session, chosen: Plan) -> None:
    """Print poses, duration and expected uncertainty of a plan."""
    rows = [
        [str(pose.number), "fit" if pose.purpose == "fit" else "fresh", *(f"{math.degrees(q):.1f}" for q in pose.q_rad)]
        for pose in chosen.poses
    ]
    columns = ["pose", "for", *axis_names(len(chosen.poses[0].q_rad))]
    session.show(grid(f"arm {chosen.arm}: rest poses [deg]", columns, rows, left=2))
    session.show(f"each pose approached from both directions, about {chosen.duration_s / 60:.1f} min per load")
    expected = chosen.expectation
    if expected is not None:
        x, y, z = (1000 * value for value in expected.com_std_m)
        session.show(
            f"expected standard deviation for a load of {expected.reference_load_kg:.3g} kg: "
            f"mass {expected.mass_std_kg:.3g} kg, centre of gravity {x:.2g} {y:.2g} {z:.2g} mm"
        )
        show_assumed(expected.noise_nm, expected.noise_source, expected.gain_std)
    if about := chosen.distinguish:
        before = about["standard_strength"]
        lines = [[name, f"{before[name]:.3g}", f"{strength:.3g}"] for name, strength in about["strength"].items()]
        session.show(grid("expected strength over the noise", ["effect", "standard plan", "this plan"], lines))
        std = (about["standard_expected"] or {}).get("mass_std_kg", math.nan)
        session.show(f"standard plan: {about['standard_duration_s'] / 60:.1f} min per load, mass {std:.3g} kg")
        if about["not_shown_by_rest_poses"]:
            session.note(f"no choice of rest poses shows {', '.join(about['not_shown_by_rest_poses'])}")
