"""Measured runs of real robots: chosen on the first run's rows, judged on rows that chose nothing.

python -m benchmarks.measured [--out out/measured]; the runs are found through SERVO_GATEWAY_DATA. Of each robot a run
`*_first.csv` or `run_A.csv` chooses. Any other run in its folder judges; where there is none, the last fifth of the
time. The interval of a ratio is that of a bootstrap over stretches of time.
"""

import sys

from tests.support.measured import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
