"""Dataset runs that are killed: does the next run end in the same bytes?

    python benchmarks/dataset_kill.py [SCENE] [--count N] [--size N] [--kills N]

makes a dataset without disturbance; then, again and again, a run is killed (SIGKILL) and another one goes on from what
it left: at every call that writes, and at random moments, the parent or a worker of it, with one process, a pool of two
and a Dask cluster of two. Prints how many kills struck and the checksums of all trees; exit code 1 if they differ.
Without a scene, units are files of text.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks import kill_points
from synth.dataset.store import names, open_store, tree_digest

PROGRAM = Path(kill_points.__file__)
UNCOUNTED = "nobody"
LONGEST = 300.0  # seconds, after which a run hangs


@dataclass(frozen=True, slots=True)
class Work:
    """What is made: `more` are the scene, number of images and unit size of the child program, or nothing."""

    folder: Path
    more: tuple[str, ...] = ()


def run(work: Work, kind: str, name: str, kill: str | None = None, seconds: float | None = None) -> int:
    """A run in a process group of its own, killed after some seconds if they are given; returns the exit code."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop(kill_points.VARIABLE, None)
    if kill is not None:
        environment[kill_points.VARIABLE] = kill
    command = [sys.executable, str(PROGRAM), kind, str(work.folder / name), *work.more]
    quiet = subprocess.DEVNULL if kill is not None or seconds is not None else None
    child = subprocess.Popen(command, env=environment, stderr=quiet, start_new_session=True)
    if seconds is not None:
        time.sleep(seconds)
        child.send_signal(signal.SIGKILL)
    return child.wait(LONGEST)


def counted(work: Work, kind: str) -> tuple[int, str]:
    """Number of calls that write in an undisturbed run, and the checksum of its tree."""
    counter = work.folder / "counter"
    counter.unlink(missing_ok=True)
    if run(work, kind, "whole", f"{counter}:0:{UNCOUNTED}"):
        raise RuntimeError(f"{kind}: a run without kills failed")
    return counter.stat().st_size, digest_of(work, "whole", remove=True)


def digest_of(work: Work, name: str, remove: bool = False) -> str:
    """Checksum of a tree."""
    found = tree_digest(open_store(str(work.folder / name)))
    if remove:
        shutil.rmtree(work.folder / name)
    return found


def killed_at(work: Work, kind: str, at: int, victim: str) -> tuple[bool, str]:
    """Whether the kill at a call struck, and the checksum after the next run."""
    counter = work.folder / "counter"
    counter.unlink(missing_ok=True)
    struck = run(work, kind, "killed", f"{counter}:{at}:{victim}") != 0
    return struck, finished(work, kind)


def killed_after(work: Work, kind: str, seconds: float) -> tuple[bool, str]:
    """The same for a kill of the parent at a moment."""
    struck = run(work, kind, "killed", None, seconds) != 0
    return struck, finished(work, kind)


def finished(work: Work, kind: str) -> str:
    """Checksum after an undisturbed run goes on."""
    if run(work, kind, "killed"):
        raise RuntimeError(f"{kind}: the run after a kill failed")
    return digest_of(work, "killed", remove=True)


def every_point_forked(folder: Path) -> tuple[int, set[str]]:
    """Kills at every write of a run in one process, by forks of this one: fast, and as real as any.

    Returns
    -------
    points : int
    digests : set of str
        Of all trees, the undisturbed one included.
    """
    counter, digests = folder / "counter", set()
    _forked(folder / "whole", counter, 0, UNCOUNTED)
    points = counter.stat().st_size
    digests.add(tree_digest(open_store(str(folder / "whole"))))
    for at in range(1, points + 1):
        counter.unlink()
        if _forked(folder / "killed", counter, at, "self") != -signal.SIGKILL:
            raise RuntimeError(f"write {at} of {points}: was not killed")
        _forked(folder / "killed", counter, 0, UNCOUNTED)
        digests.add(tree_digest(open_store(str(folder / "killed"))))
        shutil.rmtree(folder / "killed")
    return points, digests


def _forked(out: Path, counter: Path, at: int, victim: str) -> int:
    child = os.fork()
    if child == 0:
        os.environ["HANDTRACK_MAIN"] = str(os.getpid())
        kill_points.install(str(counter), at, victim)
        try:
            kill_points.run_once("serial", str(out))
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--size", type=int, default=10)
    parser.add_argument("--kills", type=int, default=50, help="at random moments, for each engine")
    parser.add_argument("--points", type=int, default=1, help="every N-th call that writes")
    parser.add_argument("--engines", default="serial,pool,dask")
    parser.add_argument("--forked", action="store_true", help="only every write of the stand-in, in one process")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.forked:
            points, digests = every_point_forked(Path(folder))
            _say(f"serial: {points} kills at {points} writes: trees {', '.join(sorted(digests))}")
            return int(len(digests) != 1)
        more = () if given.scene is None else (given.scene, str(given.count), str(given.size))
        return _all(Work(Path(folder), more), given)


def _all(work: Work, given: argparse.Namespace) -> int:
    rng, everything = random.Random(given.seed), set()
    for kind in given.engines.split(","):
        begun = time.monotonic()
        points, digest = counted(work, kind)
        seconds = time.monotonic() - begun
        digests, struck = {digest}, 0
        for at in range(1, points + 1, given.points):
            for victim in ("self",) if kind == "serial" else ("self", "parent"):
                hit, found = killed_at(work, kind, at, victim)
                struck += hit
                digests.add(found)
        hits = 0
        for _ in range(4 * given.kills):  # some runs end before their kill
            if hits == given.kills:
                break
            hit, found = killed_after(work, kind, rng.uniform(0.0, seconds))
            hits += hit
            digests.add(found)
        everything |= digests
        files = len(names(open_store(str(work.folder))))
        _say(
            f"{kind}: {struck} kills at {points} writes, {hits} kills at random moments: "
            f"trees {', '.join(sorted(digests))}; {files - 1} files left over"
        )
    return int(len(everything) != 1)


if __name__ == "__main__":
    sys.exit(main())
