"""Recordings of every shape: two arms, four to seven axes, moving periods, half-written, empty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drives.profile_file import load_profile
from drives.scaling import Constants, motor_scale
from gateway.cell.config import ArmConfig, parse_cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Period
from gateway.data.recording.writer import ArmHeader, RecordingHeader, RecordingWriter
from gateway.data.visit import NO_WORD, Visit

ROOT = Path(__file__).parents[2]
CONSTANTS = Constants(torque_rated=2.0, current_rated_a=4.0, offset_rated=None, counts_per_revolution=131072.0)
SYNC_S, PER_PERIOD = 0.004, 40
#: What the periods are said to be driven by: two harmonics an axis.
EXCITATION = 4711


def cell_text(*names: str) -> str:
    """Cells of `tests/cells` as one cell of several arms, named as they are."""
    parts = []
    for number, name in enumerate(names):
        text = (ROOT / "tests" / "cells" / name / "cell.toml").read_text(encoding="utf-8")
        head, arm = text.split("[[arm]]", 1)
        arm = arm.split("[poses]", 1)[0]
        bus = head.split("[bus.a]", 1)[1].replace(f'channel = "{name}"', f'channel = "{name}{number}"')
        parts.append(f"[bus.{name}]{bus}\n[[arm]]{arm}".replace('name = "main"', f'name = "{name}"'))
        parts[-1] = parts[-1].replace('bus = "a"', f'bus = "{name}"')
    return 'name = "several"\n' + "\n".join(parts)


def several(path: Path, *names: str, status: str | None = "success", samples: int = 6) -> Path:
    """A recording of the arms of these cells: two visits and two periods each; `None`: the run was killed."""
    text = cell_text(*names)
    cell = parse_cell(text, "cell.toml")
    robot = (ROOT / "tests" / "cells" / names[0] / "robot.urdf").read_text(encoding="utf-8")
    profiles = {"generic-cia402": load_profile("generic-cia402").text}
    header = RecordingHeader("2026-01-01T00:00:00+00:00", text, profiles, robot, "servo-gateway test")
    writer = RecordingWriter(path, header, None)
    for number, arm in enumerate(cell.arm):
        plain = {"cosine_rad": [[0.1, 0.0]] * len(arm.axis), "name": "load"}
        identities = [{"node_id": axis.node_id} for axis in arm.axis]
        writer.begin(ArmHeader(arm.name, (), (CONSTANTS,) * len(arm.axis), identities, [], {EXCITATION: plain}))
        if not samples:
            continue
        start_s = 10.0 * number
        writer.add(arm.name, _visit(arm, 1, start_s, samples))
        writer.add(arm.name, replace(_visit(arm, -1, start_s + 1, samples), load="tool ä", complete=False))
        writer.add(arm.name, _period(arm, 1, start_s + 2))
        writer.add(arm.name, _period(arm, 2, start_s + 3))
    if not samples:
        writer.finish(cell.arm[0].name, "abort", "stopped before the first pose", {})
    elif status is not None:
        writer.finish(cell.arm[0].name, status, "done", {"cycles": 3})
    writer.close()
    return path


def _words(arm: ArmConfig, seed: int, samples: int) -> dict[str, Any]:
    random = np.random.default_rng([seed, len(arm.axis)])
    scale = motor_scale(load_profile("generic-cia402"), CONSTANTS, 1.0)
    axes = AxisConversion.from_arm(arm)
    scales = np.array(
        [
            motor_scale(load_profile("generic-cia402"), CONSTANTS, each.torque_constant_nm_per_a.value).torque_nm
            for each in arm.axis
        ]
    )
    shape = (samples, len(arm.axis))
    words, counts = random.integers(-400, 400, shape), random.integers(-(10**6), 10**6, shape)
    current = random.integers(-400, 400, shape) * 0.004
    current[:, 0] = np.nan
    current_word = random.integers(-400, 400, shape)
    current_word[:, 0] = NO_WORD
    return {
        "statusword": np.full(shape, 0x1237),
        "position_count": counts,
        "torque_word": words,
        "current_word": current_word,
        "velocity_word": np.full(shape, NO_WORD),
        "q_rad": axes.joint_position(counts * scale.count_rad),
        "motor_torque_nm": words * scales,
        "joint_torque_nm": axes.joint_torque(words * scales),
        "motor_current_a": current,
    }


def _visit(arm: ArmConfig, approach: int, start_s: float, samples: int) -> Visit:
    axes = len(arm.axis)
    return Visit(
        number=0,
        load="none",
        pose=3,
        purpose="fit",
        approach=approach,
        complete=True,
        incomplete_epochs=1,
        direction=np.full(axes, approach, dtype=np.int8),
        target_rad=0.1 * np.arange(axes),
        **_words(arm, approach + 5, samples),
        sync_index=np.arange(samples) + round(100 * start_s),
        time_s=start_s + SYNC_S * np.arange(samples),
        gravity_nm=np.arange(axes) / 3.0 if approach < 0 else None,
        friction_band_nm=np.arange(axes) / 7.0 if approach < 0 else None,
    )


def _period(arm: ArmConfig, number: int, start_s: float) -> Period:
    axes = len(arm.axis)
    words = _words(arm, 10 + number, PER_PERIOD)
    return Period(
        number=0,
        load="tool ä",
        excitation=EXCITATION,
        name="load",
        kind="series",
        joint=0,
        period=number,
        speed=0.5,
        period_s=PER_PERIOD * SYNC_S,
        complete=True,
        incomplete_epochs=0,
        target_rad=words["q_rad"] + 0.001 * np.arange(axes),
        **words,
        sync_index=np.arange(PER_PERIOD) + round(100 * start_s),
        time_s=start_s + SYNC_S * np.arange(PER_PERIOD),
    )
