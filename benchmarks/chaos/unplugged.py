"""The command line with an adapter that can be pulled: from the moment a file exists, nothing is sent or received."""

from __future__ import annotations

import random
import sys
from pathlib import Path

from benchmarks.chaos.io_faults import Broken
from benchmarks.chaos.rig import adapters
from gateway.cli import main

if __name__ == "__main__":
    broken = Broken("adapter unplugged", random.Random(0))
    broken.begin_where(Path(sys.argv.pop(1)).exists)
    with adapters(broken.take):
        main()
