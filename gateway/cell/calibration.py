"""The calibration file: torque constants that were measured with a weighed load, beside the cell file.

`cell.toml` has `cell.calibration.toml`. The cell file is not changed; without the calibration file its constants apply.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AwareDatetime, Field, model_validator

from drives.toml_text import toml_string
from drives.validation import Strict, Unfit, read_strict
from gateway.cell.quantities import Finite, PlainName, Positive, Vector3
from gateway.errors import ConfigError

#: A true torque is within this factor of the stated one; beyond it the constant is in another unit.
_MOST_SCALE: Final = 10.0
_HEADER: Final = """\
# Torque constants measured by `servo-gateway calibrate`, used together with {cell}.
# torque_scale: true torque over the torque by the constants of the cell file; std_percent: its standard deviation.
# Rename or delete this file to use the constants of the cell file alone.
"""


class CalibratedAxis(Strict):
    """Torque constant of one axis, and what it was measured with."""

    joint: int = Field(ge=1, description="counts from 1")
    torque_scale: Annotated[float, Field(gt=1.0 / _MOST_SCALE, lt=_MOST_SCALE)]
    std_percent: Annotated[float, Field(gt=0, lt=30)]
    torque_constant_nm_per_a: Positive | None = Field(
        default=None, description="measured; absent where the drive reports torque by a constant of its own"
    )
    stated_nm_per_a: Finite = Field(description="of the cell file at that time, and so the next two")
    stated_gear_ratio: Finite
    stated_gear_efficiency: Finite
    residual_nm: Finite | None = Field(default=None, description="rms of measured less modelled torque")
    temperature_c: Finite | None = Field(default=None, description="mean of motor or drive, where it is reported")
    serial_number: int | None = Field(default=None, description="of the drive, where it reports one")


class ArmCalibration(Strict):
    """One calibration of one arm."""

    name: PlainName = Field(description="of the arm")
    measured: AwareDatetime
    load: PlainName = Field(description="label of the weighed load")
    mass_kg: Positive
    mass_std_kg: Positive | None = Field(default=None, description="its standard deviation; absent where it is exact")
    com_m: Vector3 | None = Field(default=None, description="in the last link; absent where it was estimated")
    com_std_m: Positive | None = Field(default=None, description="of each coordinate; absent where they are exact")
    data: tuple[str, ...] = Field(description="names of the files")
    axis: tuple[CalibratedAxis, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _each_axis_once(self) -> ArmCalibration:
        joints = [axis.joint for axis in self.axis]
        if len(set(joints)) < len(joints):
            raise ValueError("an axis is named twice")
        return self

    @property
    def source(self) -> str:
        """Return the source of the constants for the provenance of a result."""
        return f"measured {self.measured:%Y-%m-%d} with load {self.load} of {self.mass_kg:.6g} kg"


class CalibrationFile(Strict):
    """Content of a calibration file: one table per calibration; for each axis the last one applies."""

    arm: tuple[ArmCalibration, ...] = Field(min_length=1)

    def of(self, arm: str) -> dict[int, tuple[ArmCalibration, CalibratedAxis]]:
        """Return the calibration that applies to each axis of an arm, by joint."""
        return {axis.joint: (each, axis) for each in self.arm if each.name == arm for axis in each.axis}

    def with_new(self, new: ArmCalibration) -> CalibrationFile:
        """Return a copy with one more calibration, without those that it replaces completely."""
        complete = CalibrationFile(arm=(*self.arm, new))
        held = [each for arm in {each.name for each in complete.arm} for each, _ in complete.of(arm).values()]
        return CalibrationFile(arm=tuple(each for each in complete.arm if each in held))


def calibration_path(cell: Path) -> Path:
    """Return the path of the calibration file of a cell file."""
    return cell.with_name(f"{cell.stem}.calibration.toml")


def read_calibration(cell: Path) -> str:
    """Text of the calibration file of a cell file, checked; empty where there is none.

    Raises
    ------
    ConfigError
        It cannot be read, or is not such a file: line, what is wrong, what to write.
    """
    path = calibration_path(cell)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    parse_calibration(text, str(path))
    return text


def parse_calibration(text: str, where: str) -> CalibrationFile | None:
    """Validate the text of a calibration file; None where it is empty.

    Raises
    ------
    ConfigError
    """
    if not text.strip():
        return None
    try:
        return read_strict(text, CalibrationFile)
    except Unfit as error:
        raise ConfigError.of(error.messages(where)) from error


def calibration_toml(file: CalibrationFile, cell: str) -> str:
    """Return the text of the calibration file of a cell file."""
    parts = [_HEADER.format(cell=cell)]
    for arm in file.arm:
        parts += ["", "[[arm]]", *_lines(arm.model_dump(exclude={"axis"}))]
        for axis in arm.axis:
            parts += ["", "[[arm.axis]]", *_lines(axis.model_dump())]
    return "\n".join(parts) + "\n"


def _lines(values: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]


def _toml(value: Any) -> str:
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="seconds")
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return toml_string(value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)
