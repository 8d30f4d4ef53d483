"""A posture to measure, as plans and recordings name it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Purpose = Literal["fit", "validation"]


@dataclass(frozen=True, slots=True)
class RestPose:
    """One posture to measure; `number` is its name in every file."""

    number: int
    q_rad: tuple[float, ...]
    purpose: Purpose
