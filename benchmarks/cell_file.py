"""Cell files of drawn arms, and the commands that read them, in this process."""

from __future__ import annotations

from pathlib import Path

from numpy.typing import ArrayLike

CELL = """name = "drawn"
[bus.a]
interface = "virtual"
channel = "drawn"
[[arm]]
name = "main"
bus = "a"
robot = "arm.urdf"
inertials = "prior:0.05"
rated_load_kg = {{ value = {rated:.6g}, source = "drawn" }}
{axes}"""
AXIS = """[[arm.axis]]
node_id = {number}
profile = "generic-cia402"
torque_constant_nm_per_a = {{ value = 1.0, source = "datasheet", std_percent = {std_percent:.6g} }}
gear_ratio = {{ value = 100, source = "drawn" }}
gear_efficiency = {{ value = 1.0, source = "assumed" }}
position_sign = 1
torque_sign = 1
zero_offset_rad = 0.0
position_limit_rad = [{low:.6g}, {high:.6g}]
speed_limit_rad_s = 0.5
torque_limit_nm = {torque:.6g}
"""


def write_cell_file(
    folder: Path, rated_kg: float, limit_rad: ArrayLike, torque_nm: ArrayLike, gain_std: float = 0.03
) -> None:
    """Write the cell file of an arm with `arm.urdf` beside it; joint and torque limits (N,)."""
    axes = [
        AXIS.format(number=number, low=-limit, high=limit, torque=torque, std_percent=100.0 * gain_std)
        for number, (limit, torque) in enumerate(zip(limit_rad, torque_nm, strict=True), 1)  # pyright: ignore
    ]
    (folder / "cell.toml").write_text(CELL.format(rated=rated_kg, axes="".join(axes)), encoding="utf-8")


def invoked(*words: object) -> tuple[int, str]:
    """Exit code and output of a command."""
    from click.testing import CliRunner

    from gateway.cli import main as command

    done = CliRunner(env={"COLUMNS": "200"}).invoke(command, [str(word) for word in words])
    return done.exit_code, done.stderr
