"""Static posture to measure, as plans and recordings identify it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Purpose = Literal["fit", "validation"]


@dataclass(frozen=True, slots=True)
class RestPose:
    """Static posture to measure; `number` identifies it in every file."""

    number: int
    q_rad: tuple[float, ...]
    purpose: Purpose
