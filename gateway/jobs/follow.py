"""Follow a path without feedforward, with the maximum load assumed, and with the identified load."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

from gateway.acquire.events import Progress
from gateway.feedforward.identified import notes_of, with_identified
from gateway.follow.comparison import result_of
from gateway.follow.path import refuse_other_axes
from gateway.follow.path_run import follow as drive
from gateway.follow.settings import prepare
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import Operator, begin_motion
from gateway.model.arm_model import arm_named
from gateway.motion.stream import MoveOptions
from gateway.result.follow import FollowResult
from gateway.result.library import result_file
from gateway.result.origin import Origin, drives_of, files_of, in_words, software


def follow(
    context: CellContext,
    path_file: Path,
    load_file: Path,
    operator: Operator,
    options: MoveOptions,
    *,
    label: str | None = None,
    identified: Path | None = None,
    arm: str | None = None,
    trace: Path | None = None,
    operator_name: str | None = None,
) -> FollowResult:
    """Follow a path under each setting of the feedforward, after confirmation, and compare the following errors.

    Parameters
    ----------
    context : CellContext
    path_file : Path
        TOML or CSV file of joint waypoints or timed points [rad, s].
    load_file : Path
        Result of this arm, or `CELL.loads.json#LABEL`.
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    label : str, optional
        Load of the result, if it holds several.
    identified : Path, optional
        Result with friction and rotor inertia, instead of that of the cell.
    arm : str, optional
        Name of the arm, if the cell has several.
    trace : Path, optional
        File of the frame log to write.
    operator_name : str, optional
        For the report.

    Returns
    -------
    FollowResult
        Following errors [rad] and torques [Nm] of each setting, with findings and origin.

    Raises
    ------
    ConfigError, InputError, DataUnusable, PlanRefused
        As `gateway.follow.settings.prepare`, or the arm has not six axes; nothing moved.
    FindingFailed, LimitExceeded, DriveError, KeyboardInterrupt
        As `begin_motion` and `gateway.follow.path_run.follow`.
    """
    config = arm_named(context.loaded, arm)
    context = replace(context, loaded=with_identified(context.loaded, config.name, identified))
    config = arm_named(context.loaded, config.name)
    refuse_other_axes(config, "follow")
    prepared = prepare(context.loaded, config, path_file, load_file, label)
    path, total_s = prepared.path, prepared.duration_s
    names = ", ".join(setting.name for setting in prepared.settings)
    operator.say(f"path {path.name}: {path.duration_s:.1f} s under each of the settings {names}")
    for setting in prepared.settings:
        if setting.load is not None:
            com = " ".join(f"{1000 * value:.0f}" for value in setting.load.com_m)
            operator.say(f"{setting.name}: {setting.load.mass_kg:.2f} kg at {com} mm in link_6 ({setting.load.source})")
    for joints, note in notes_of([axis.notes for axis in prepared.model.sources]):
        operator.say(f"{joints}: {note}")
    with context.opened(config, trace=trace, offsets=("velocity", "torque")) as opened:
        identities = [asdict(identity) for identity in opened.identities]
        options = begin_motion(context, (opened,), options, operator)
        with context.last_seconds(options, opened), operator.progress(total_s, "follow") as listener:
            parts, pacing = (prepared.workspace, path, prepared.settings), opened.group.timing.pacing
            steps = round(total_s / path.period_s)

            def report(what: str, done_s: float) -> None:
                listener(Progress(round(done_s / path.period_s), steps, what, done_s, total_s - done_s))

            tracks = drive(opened.arm, *parts, report, options, pacing)
    used = None if config.identified is None else context.loaded.path(config.identified)
    files = (context.path, path_file, result_file(load_file)[0], used)
    checksums = files_of(file for file in files if file)
    origin = Origin(in_words(datetime.now(UTC)), software(), drives_of(identities), checksums, operator_name)
    return replace(result_of(prepared, tracks), origin=origin)
