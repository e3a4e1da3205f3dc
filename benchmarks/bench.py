"""Side-by-side timings on one thread, memory over 20 000 frames, a dataset of 10 000 images: `benchmarks/bench.py`.

Linear algebra libraries read their thread counts when they are loaded, hence the environment before the import.
"""

import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ[name] = "1"

from handtrack.cli import main

MESH = Path(__file__).parents[2] / "shared" / "data" / "hand_mesh" / "right.glb"

if __name__ == "__main__":
    more = ["--surface", str(MESH)] if MESH.exists() else []
    sys.exit(main(["bench", "--memory-frames", "20000", "--dataset-images", "10000", *more, *sys.argv[1:]]))
