"""Diagnosis: find the physical effect that explains the residual of the model, or recommend further measurements."""

from gateway.diagnose.entry import diagnose
from gateway.diagnose.loop import close_loop, next_poses

__all__ = ["close_loop", "diagnose", "next_poses"]
