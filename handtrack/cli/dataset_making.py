"""Arguments of `handtrack dataset SCENE` in, a finished dataset and its figures out."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from ..errors import InputError
from .console import finite
from .dataset_progress import image_progress


@dataclass(frozen=True, slots=True)
class Machine:
    """What does the work; the dataset's bytes do not depend on it.

    Attributes
    ----------
    engine : "pool" or "dask"
    workers : int or None
        Processes; None for one for each core.
    scheduler : str or None
        Address of a running Dask scheduler.
    remote : bool
        Whether that may be another machine's.
    """

    engine: Literal["pool", "dask"] = "pool"
    workers: int | None = None
    scheduler: str | None = None
    remote: bool = False


@dataclass(frozen=True, slots=True)
class MakingFacts:
    """What a run did, for its last line.

    Attributes
    ----------
    uri : str
    images, made, size : int
        Images of the dataset, those made by this run, and bytes of all files.
    seconds : float
    """

    uri: str
    images: int
    made: int
    size: int
    seconds: float

    @property
    def rate(self) -> float:
        """Images made in a second."""
        return self.made / self.seconds if self.seconds > 0 else float("nan")

    def as_line(self) -> str:
        """For people."""
        old = self.images - self.made
        there = f" ({old} were there)" if old else ""
        size = f"{self.size / 1e6:.1f} MB"
        return f"{self.uri}: {self.images} images{there}, {size}, {self.seconds:.1f} s, {self.rate:.1f} images/s"

    def as_data(self) -> Any:
        """For machines."""
        return finite(
            {
                "uri": self.uri,
                "images": self.images,
                "made": self.made,
                "bytes": self.size,
                "seconds": round(self.seconds, 3),
                "images_per_second": round(self.rate, 3),
            }
        )


def made(
    scene: Path,
    out: str,
    options: Sequence[str],
    layout: Literal["shards", "coco", "folders"],
    seed: int,
    count: int,
    shard_size: int,
    surface: Path | None,
    machine: Machine,
) -> MakingFacts:
    """Make a dataset.

    Raises
    ------
    InputError
        For bad arguments, a bad scene, or a place that holds something else.
    synth.dataset.engine.Stopped
        If it ended before the dataset was whole.
    """
    needed()
    from synth.dataset.engine import run
    from synth.dataset.job import dataset_record, fixed_files, job_of, merged_files, unit_files
    from synth.dataset.store import open_store

    begun = time.monotonic()
    store = open_store(out, options)
    chosen = engine_of(machine, -(-count // shard_size))
    job = job_of(scene, layout, seed, count, shard_size, surface)
    with image_progress("images", count) as done:
        summary = run(
            store,
            dataset_record(job),
            fixed_files(job),
            partial(unit_files, job),
            partial(merged_files, layout),
            chosen,
            done,
        )
    return MakingFacts(out, summary.count, summary.made, summary.size, time.monotonic() - begun)


def engine_of(machine: Machine, units: int) -> Callable[..., Any]:
    """The engine that a machine asks for.

    Raises
    ------
    InputError
        If options of Dask are given to a pool, or its address is bad.
    """
    from synth.dataset.dask_engine import check_address, dasked
    from synth.dataset.engine import pooled, serial

    workers = machine.workers or cores()
    if machine.engine == "dask":
        if machine.scheduler is not None:
            check_address(machine.scheduler, machine.remote)
        return partial(dasked, workers=workers, scheduler=machine.scheduler, remote=machine.remote)
    if machine.scheduler is not None or machine.remote:
        raise InputError("--scheduler, --allow-remote: go with --engine dask")
    return serial if min(workers, units) == 1 else partial(pooled, workers=workers)


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def needed() -> None:
    """Make sure that the packages of the extra are there.

    Raises
    ------
    InputError
        If one is missing.
    """
    for name in ("fsspec", "pyarrow"):
        try:
            import_module(name)
        except ImportError as error:
            raise InputError(f"dataset: needs the package {name}; install handtrack[dataset]") from error
