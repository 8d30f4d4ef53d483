"""Cells of arms that have not six axes: a palletiser of four, a lightweight arm of seven; plausible values, made up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gateway.model.robot import Robot, robot_from_urdf

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class CellOf:
    """A folder with cell.toml, robot.urdf and payload.toml.

    `turning` axes are those that gravity acts on; `rest_rank` and `moving_rank` the base parameters of the arm.
    """

    name: str
    axes: int

    @property
    def folder(self) -> Path:
        return FOLDER / self.name

    @property
    def urdf(self) -> str:
        return (self.folder / "robot.urdf").read_text(encoding="utf-8")

    @property
    def robot(self) -> Robot:
        return robot_from_urdf(self.urdf, str(self.folder / "robot.urdf"))


CELLS = (CellOf("four", 4), CellOf("seven", 7))
