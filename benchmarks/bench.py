"""Side-by-side timings on one thread, and memory over 20 000 frames: `python benchmarks/bench.py [--json]`.

Linear algebra libraries read their thread counts when they are loaded, hence the environment before the import.
"""

import os
import sys

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

from handtrack.cli import main

if __name__ == "__main__":
    sys.exit(main(["bench", "--memory-frames", "20000", *sys.argv[1:]]))
