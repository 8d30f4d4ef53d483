"""Linear algebra in one thread: for small matrices two take ten times as long, and processes share the cores."""

from __future__ import annotations

import os


def one_thread() -> None:
    """Limit this process and its children; to be called before numpy is imported, which reads the limits then."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
