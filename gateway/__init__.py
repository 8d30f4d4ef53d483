"""Load identification of robot arms from the torque of their own drives."""

import os

__version__ = "0.1.0"

# The matrices are small: threads of the linear algebra cost more than they give, most of all on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
