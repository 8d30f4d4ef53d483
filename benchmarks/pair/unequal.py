"""Two different arms: a large and a small one, one of seven axes and one of six.

python -m benchmarks.pair.unequal [--cells large-small,seven-six] [--seeds 0,1,2] [--out out/pair-unequal]

Of each cell of `examples/pair-unequal` and each seed, over PyBullet and all CAN drives: nine points are taught, then
rows A, B, C1i and twelve cycles of C8 at speed 1.5. Printed are the largest true force inside the part, the cycles
until it stays below the limit, and the coverage of the 95 % intervals of the force.
"""

import sys

from tests.support.pair.unequal import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
