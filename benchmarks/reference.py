"""Pages of the reference that the code itself can write: keys of cell file and drive profile, commands, result.

python -m benchmarks.reference [--write]: say which pages are not current, or bring them up to date.
"""

import sys

from tests.support.reference import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
