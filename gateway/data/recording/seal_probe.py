"""Read one recording in a separate process without output, for files that may crash the reader."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

from gateway.data.recording.reader import read_unsealed
from gateway.errors import InputError

MEMORY_BYTES = 4 * 2**30
CPU_S = 30


def main() -> int:
    """Exit with 0 if the reader returns, with a recording or with a typed error."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    try:
        read_unsealed(Path(sys.argv[1])).table()
    except InputError:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
