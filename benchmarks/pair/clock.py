"""Two arms in real time: taught, run and kept at a gap, beside the same plant in lockstep.

python -m benchmarks.pair.clock [--seeds 3,4,5,6] [--cycles 25] [--parts run,gap] [--period-ms 4] [--out out/pair-clock]

Twelve drives in a process of their own, over the plant that keeps up with the clock, at a 4 ms SYNC. The period is
longer where this computer is too slow for that. The true force inside the part and the true gaps are recorded.
A cycle that a stall of the machine has stopped is counted and repeated from the start. So is a stop by the force limit
after a delayed SYNC; any other stop fails.
"""

import sys

from tests.support.pair.clock import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
