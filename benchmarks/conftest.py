"""What is measured computes as the command line does: on one core."""

import os

# Before anything imports numpy, which reads it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
