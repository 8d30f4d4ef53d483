"""How the house stands: files, lines, circles of imports, imports from a lower room to a higher one, repeated names.

python -m benchmarks.house [--out out/house] [--list]
"""

import sys

from tests.support.house import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
