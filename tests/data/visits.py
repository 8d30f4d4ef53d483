"""Visits as a small arm would have been measured, and the header of their recording."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drives.profile_file import load_profile
from drives.scaling import Constants, motor_scale
from gateway.cell.config import LoadedCell, load_cell
from gateway.cell.conversion import AxisConversion
from gateway.data.period import Period
from gateway.data.recording.writer import ArmHeader, RecordingHeader, RecordingWriter, write_recording
from gateway.data.visit import NO_WORD, RestPose, Visit
from gateway.model.arm_model import robot_text

CELL = Path(__file__).parents[2] / "examples" / "small" / "cell.toml"
CONSTANTS = Constants(torque_rated=2.0, current_rated_a=4.0, offset_rated=None, counts_per_revolution=131072.0)
POSES = (RestPose(1, (0.1,) * 6, "fit"), RestPose(2, (0.2,) * 6, "fit"), RestPose(3, (0.3,) * 6, "validation"))
SAMPLES = 12


ARM_HEADER = ArmHeader("main", POSES, (CONSTANTS,) * 6, [{"node_id": 1}], [{"index": 0x6060, "old": 1}])


def header_of(cell: LoadedCell) -> RecordingHeader:
    """What is stored once per file."""
    return RecordingHeader(
        created="2025-01-01T00:00:00+00:00",
        cell=cell.text,
        profiles={"generic-cia402": load_profile("generic-cia402").text},
        robot=robot_text(cell, cell.cell.arm[0]),
        software="servo-gateway test",
    )


def visit(
    pose: int = 1, approach: int = -1, load: str = "none", seed: int = 0, start_s: float = 0.0, samples: int = SAMPLES
) -> Visit:
    """One side of a pose, of random words that fit together."""
    random = np.random.default_rng([seed, pose, approach + 1])
    scale = motor_scale(load_profile("generic-cia402"), CONSTANTS, 1.0)
    words = random.integers(-400, 400, (samples, 6))
    currents = random.integers(-400, 400, (samples, 6))
    axes = AxisConversion.from_arm(load_cell(CELL).cell.arm[0])
    counts = random.integers(-(10**6), 10**6, (samples, 6))
    return Visit(
        number=0,
        load=load,
        pose=pose,
        purpose="fit" if pose < 3 else "validation",
        approach=approach,
        complete=True,
        incomplete_epochs=2,
        direction=np.full(6, approach, dtype=np.int8),
        target_rad=np.full(6, 0.1 * pose),
        statusword=np.full((samples, 6), 0x1237),
        position_count=counts,
        torque_word=words,
        current_word=currents,
        velocity_word=np.full((samples, 6), NO_WORD),
        q_rad=axes.joint_position(counts * scale.count_rad),
        motor_torque_nm=words * scale.torque_nm,
        joint_torque_nm=axes.joint_torque(words * scale.torque_nm),
        motor_current_a=currents * 0.004,
        sync_index=np.arange(100, 100 + samples),
        time_s=start_s + 0.01 * np.arange(samples),
    )


def both_sides(*poses: int, load: str = "none", seed: int = 0) -> list[Visit]:
    """Poses, each approached from both directions."""
    return [visit(pose, side, load, seed, start_s=pose + 0.5 * side) for pose in poses for side in (-1, 1)]


def recording_of(
    path: Path, header: RecordingHeader, content: Sequence[Visit | Period], arm: ArmHeader = ARM_HEADER, finish=True
) -> Path:
    """A recording of one arm; without `finish` as a killed run leaves it."""
    writer = RecordingWriter(path, header, None)
    writer.begin(arm)
    for each in content:
        writer.add("main", each)
    if finish:
        writer.finish("main", "success", "all poses measured", {"cycles": 7})
    writer.close()
    return path


def write_slowly(pause_s: float, path: Path, content: bytes) -> None:
    """A disk that takes its time."""
    time.sleep(pause_s)
    write_recording(path, content)


def write_behind(gate: Path, path: Path, content: bytes) -> None:
    """A disk that blocks until the gate is there, or its opener has ended."""
    end_s = time.monotonic() + 20.0
    while not gate.exists() and time.monotonic() < end_s:
        time.sleep(0.002)
    write_recording(path, content)
