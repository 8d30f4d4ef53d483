"""Measurement with `--until`: choose the next pose, and stop as soon as the load's uncertainty is small enough."""
