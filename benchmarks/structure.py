"""Structure of the code: files, lines, circular imports, imports from a lower layer to a higher one, repeated names.

python -m benchmarks.structure [--out out/structure] [--list]
"""

import sys

from tests.support.code_structure import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
