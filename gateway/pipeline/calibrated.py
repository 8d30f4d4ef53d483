"""Apply a calibration file in an analysis: check where its constants are valid, convert them, report them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Final

import numpy as np

from gateway.cell.calibration import ArmCalibration, CalibratedAxis, parse_calibration
from gateway.cell.config import ArmConfig, AxisConfig
from gateway.data.recording.recorded import Recording
from gateway.identify.nuisance import day_std
from gateway.result.origin import drives_of
from gateway.result.result import Finding

#: Age from which a calibration is reported as old. A torque constant that changes by 0.5 % to 1 % in a year (magnets,
#: gear wear, exchanged parts) has then moved by about the standard deviation of a calibration.
OLD: Final = timedelta(days=180)
#: Standard deviation by which a torque constant moves in a month, and at most: magnets, gear wear, exchanged parts.
_AGEING: Final = 0.001
_MOST_AGEING: Final = 0.01
_MONTH: Final = timedelta(days=365.25 / 12)
_AGAIN: Final = "calibrate again (servo-gateway calibrate CELL --known LABEL=MASS)"


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """Calibrated torque constants of an arm with N axes.

    Attributes
    ----------
    scale : array of shape (N,)
        True torque divided by the torque with the constants of the cell file; 1 without a valid calibration.
    std : array of shape (N,)
        Relative standard deviation of the constants of the arm, with what they have moved since the calibration; NaN
        without a valid one. The change of the calibration's own occasion is in it, that of an occasion of use is not.
    findings : tuple of Finding
    provenance : mapping of "J1" to entries by name, for the axes with a valid calibration
    """

    scale: np.ndarray
    std: np.ndarray
    findings: tuple[Finding, ...] = ()
    provenance: Mapping[str, dict[str, Any]] = field(default_factory=dict)

    def gain_std(self, stated: Sequence[float], change: float = 1.0) -> tuple[float, ...]:
        """Return the relative standard deviations (N,) of the torque constants; else the stated ones.

        `change` is the factor on the change of gain in the model of the use. A warm arm changes less during a day,
        and not less from one day to another.
        """
        return tuple(np.where(np.isfinite(self.std), np.hypot(self.std, day_std(change)), stated).tolist())


def serial_numbers(recordings: Sequence[Recording], arm: str) -> dict[int, int]:
    """Return the serial number of the drive of each joint, where one is reported."""
    parts = [part for recording in recordings if (part := recording.arm(arm)) is not None]
    return {
        drive.joint: drive.serial_number
        for part in parts
        for drive in drives_of(part.identities)
        if drive.serial_number
    }


def calibrated(text: str, where: str, arm: ArmConfig, serials: Mapping[int, int], now: datetime) -> Calibrated | None:
    """Apply the text of a calibration file to an arm; None if it holds no calibration of this arm.

    Parameters
    ----------
    text : str
    where : str
        Name of the file, for messages.
    arm : ArmConfig
    serials : mapping of joint to serial number
        Serial numbers of the drives that measured; empty where not known.
    now : datetime

    Raises
    ------
    ConfigError
        The text is not a calibration file.
    """
    file = parse_calibration(text, where)
    stored = {} if file is None else file.of(arm.name)
    if not stored:
        return None
    scale, std = np.ones(len(arm.axis)), np.full(len(arm.axis), np.nan)
    findings, provenance = list[Finding](), dict[str, dict[str, Any]]()
    used: dict[int, tuple[ArmCalibration, CalibratedAxis]] = {}
    for joint, (run, axis) in sorted(stored.items()):
        if joint > len(arm.axis):
            continue
        wrong = _refused(axis, arm.axis[joint - 1], serials.get(joint))
        if wrong:
            what = f"the calibration of {run.measured:%Y-%m-%d} is not used: {wrong}"
            findings.append(Finding("warn", f"J{joint}", what, _AGAIN))
            continue
        scale[joint - 1] = axis.torque_scale
        moved = min(max(_AGEING * ((now - run.measured) / _MONTH), 0.0), _MOST_AGEING)  # at this age
        std[joint - 1] = np.hypot(axis.std_percent / 100.0, moved)
        provenance[f"J{joint}"] = dict(_entries(run, axis))
        used[joint] = run, axis
    return Calibrated(scale, std, (*_named(used, now), *findings), provenance)


def _refused(axis: CalibratedAxis, stated: AxisConfig, serial: int | None) -> str:
    """Return the reason why a stored constant does not belong to an axis; empty if it does."""
    if serial and axis.serial_number and serial != axis.serial_number:
        return f"it belongs to the drive with serial number {axis.serial_number}, the present drive has {serial}"
    for name, was, now in (
        ("torque_constant_nm_per_a", axis.stated_nm_per_a, stated.torque_constant_nm_per_a.value),
        ("gear_ratio", axis.stated_gear_ratio, stated.gear_ratio.value),
        ("gear_efficiency", axis.stated_gear_efficiency, stated.gear_efficiency.value),
    ):
        if not np.isclose(was, now, rtol=1e-6):
            return f"the cell file now states {name} {now:g}, but stated {was:g} at the calibration"
    return ""


def _entries(run: ArmCalibration, axis: CalibratedAxis) -> Iterator[tuple[str, dict[str, Any]]]:
    source = f"{run.source}, standard deviation {axis.std_percent:.2g} %"
    yield "torque_scale", {"value": axis.torque_scale, "unit": "-", "source": source}
    if axis.torque_constant_nm_per_a is not None:
        yield "torque_constant", {"value": axis.torque_constant_nm_per_a, "unit": "Nm/A", "source": source}


def _named(used: Mapping[int, tuple[ArmCalibration, CalibratedAxis]], now: datetime) -> Iterator[Finding]:
    """Report each calibration that is used, and those that are old."""
    for run in dict.fromkeys(run for run, _ in used.values()):
        axes = [(joint, axis) for joint, (other, axis) in used.items() if other == run]
        each = ", ".join(f"J{joint} {axis.torque_scale:.4f} ± {axis.std_percent / 100:.4f}" for joint, axis in axes)
        what = f"torque constants {run.source}; factors applied to the stated constants (standard deviation): {each}"
        yield Finding("info", "calibration", what)
        if now - run.measured > OLD:
            days = (now - run.measured).days
            what = f"the torque constants were calibrated {days} days ago, more than {OLD.days}: they may have changed"
            yield Finding("warn", "calibration", what, _AGAIN)
