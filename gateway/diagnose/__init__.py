"""Diagnosis: from the residual to the effect that the model lacks, and what to measure where that is open."""

from gateway.diagnose.entry import diagnose
from gateway.diagnose.loop import close_loop, next_poses
from gateway.diagnose.options import DiagnoseOptions

__all__ = ["DiagnoseOptions", "close_loop", "diagnose", "next_poses"]
