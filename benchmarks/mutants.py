"""Do the tests notice? One operator flipped, one `not` or one `raise` dropped at a time, then the mirrored tests.

python -m benchmarks.mutants [--count 200] [--seed 1] [--jobs 2] [--packages drives,gateway/motion] [--out out/mutants]

Mutants are drawn at random over all places of the packages, each is tried in a copy of the project. The mirrored tests
of the fast suite run once as they are, and have to pass. Then the tests that cover the changed lines run first, then
the others, then the slow suite. What no test notices is listed with its place.
"""

import sys

from tests.support.mutants import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
