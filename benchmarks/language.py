"""Count words of the old private vocabulary and long sentences by package; draw docstrings and messages at random.

python -m benchmarks.language [--list PACKAGE] [--write] [--sample SEED] [--no-spelling]
"""

import sys

from tests.support.language import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
