"""A number of images in, how fast datasets of them are made, with one process and with two, and verified, out."""

import os
import resource
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

SCENE = """format: handtrack/scene-1
image: {width: 256, height: 256, type: jpg}
camera: {fov: [35, 60], distance: [350, 650]}
hands: [{kind: pills, side: any}]
"""


@dataclass(frozen=True, slots=True)
class Rate:
    """Images a second of some work, start of processes included, and the most memory that one process took."""

    name: str
    images: int
    seconds: float
    most_mb: float

    @property
    def rate(self) -> float:
        """Images a second."""
        return self.images / self.seconds

    def as_line(self) -> str:
        """For people."""
        return f"{self.name}: {self.images} images, {self.rate:.1f} a second, at most {self.most_mb:.0f} MB a process"

    def as_data(self) -> dict[str, object]:
        """For machines."""
        return {"name": self.name, "images": self.images, "seconds": self.seconds, "most_mb": self.most_mb}


def rates(images: int, folder: Path) -> list[Rate]:
    """Make a dataset of 256 x 256 images with all labels in shards with two processes, verify it, make it with one.

    Parameters
    ----------
    folder : Path
        Where to make it; what is made is removed.
    """
    scene, out = folder / "rate.yaml", folder / "dataset"
    scene.write_text(SCENE, encoding="utf-8")
    found = []
    single = max(images // 2, 1)  # as many for each process: starting takes its share of both
    for workers, count in ((2, images), (1, single)):
        size = str(max(1, min(1000, count // 10)))
        name = f"dataset, 256x256, all labels, shards, {workers} process{'es' if workers > 1 else ''}"
        arguments = [str(scene), "--out", str(out), "--count", str(count), "--shard-size", size]
        found.append(_timed(name, count, [*arguments, "--workers", str(workers)]))
        if workers > 1:
            found.append(_timed("dataset verified, 1 % rendered again", count, ["verify", str(out)]))
        shutil.rmtree(out)
    return found


def _timed(name: str, images: int, arguments: list[str]) -> Rate:
    """Run a dataset command in a process of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    begun = perf_counter()
    command = [sys.executable, "-m", "handtrack", "dataset", *arguments]
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    seconds = perf_counter() - begun
    return Rate(name, images, seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0)
