"""Arguments of `handtrack dataset verify` in, what is wrong with a dataset out."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .console import note, warning
from .dataset_making import Machine, engine_of, needed
from .dataset_progress import image_progress

if TYPE_CHECKING:
    from synth.dataset.job import Job
    from synth.dataset.record import DatasetRecord
    from synth.dataset.store import Store
    from synth.dataset.verify import Verdict


@dataclass(frozen=True, slots=True)
class VerifyingFacts:
    """What was found, for the last line."""

    uri: str
    verdict: "Verdict"
    seconds: float

    def as_line(self) -> str:
        """For people."""
        v = self.verdict
        good = "whole" if not v.problems else "NOT whole"
        return (
            f"{self.uri}: {good}: {v.images} images in {v.units} units, {v.files} files, {v.size / 1e6:.1f} MB; "
            f"labels of {v.labels} checked, {v.rendered} rendered again, {self.seconds:.1f} s"
        )

    def as_data(self) -> Any:
        """For machines."""
        v = self.verdict
        return {
            "uri": self.uri,
            "whole": not v.problems,
            "images": v.images,
            "units": v.units,
            "files": v.files,
            "bytes": v.size,
            "labels_checked": v.labels,
            "rendered_again": v.rendered,
            "problems": list(v.problems),
            "seconds": round(self.seconds, 3),
        }


def verified(
    uri: str, options: Sequence[str], scene: Path | None, surface: Path | None, share: float, workers: int | None
) -> VerifyingFacts:
    """Check a dataset.

    Raises
    ------
    InputError
        If there is none, or the scene is another one.
    """
    needed()
    from synth.dataset.plan import unit_count
    from synth.dataset.store import open_store
    from synth.dataset.verify import opened
    from synth.dataset.verify import verified as checked

    begun = time.monotonic()
    store = open_store(uri, options)
    record = opened(store)
    engine = engine_of(Machine(workers=workers), unit_count(record.count, record.unit_size))
    with _job(store, record, scene, surface, share) as job, image_progress("checked", record.count) as done:
        verdict = checked(store, record, job, share, engine, lambda images: done(images, 0))
    return VerifyingFacts(uri, verdict, time.monotonic() - begun)


@contextmanager
def _job(
    store: "Store", record: "DatasetRecord", scene: Path | None, surface: Path | None, share: float
) -> Iterator["Job | None"]:
    """The job that made a dataset, to render with; None where its scene's files are not at hand."""
    from synth.dataset.job import SCENE, job_of, versions
    from synth.dataset.store import read

    others = [name for name, _ in record.inputs if name != SCENE]
    if share == 0:
        yield None
        return
    if others and scene is None:
        note(f"not rendered again: the scene refers to other files ({others[0]}); give its scene file with --scene")
        yield None
        return
    for name, value in versions():
        made = dict(record.versions).get(name)
        if made != value:
            warning(f"{name} {made} made it, {value} is here: what is rendered again may differ")
    with tempfile.TemporaryDirectory() as folder:
        if scene is None:
            scene = Path(folder, SCENE)
            scene.write_bytes(read(store, SCENE))
        job = job_of(scene, record.layout, record.seed, record.count, record.unit_size, surface)
        changed = sorted({name for name, _ in {*record.inputs} ^ {*job.inputs}})
        if changed:
            raise InputError(f"{scene}: {changed[0]} is not what the dataset was made from")
        yield job
