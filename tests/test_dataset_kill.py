"""Claims about runs that are killed: the next one ends in the bytes of an undisturbed run."""

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks import dataset_kill
from benchmarks.dataset_kill import Work, counted, killed_after, killed_at

PROGRAM = Path(dataset_kill.__file__)


def test_a_kill_at_any_write_changes_no_byte():
    done = subprocess.run(
        [sys.executable, str(PROGRAM), "--forked"], capture_output=True, text=True, timeout=100, check=True
    )
    kills, trees = done.stdout.split(": trees ")
    assert int(kills.split()[1]) > 50
    assert len(trees.split(",")) == 1


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return Work(tmp_path_factory.mktemp("killed"))


@pytest.fixture(scope="module")
def whole(work):
    begun = time.monotonic()
    points, digest = counted(work, "pool")
    return points, digest, time.monotonic() - begun


@pytest.mark.parametrize(("share", "victim"), [(0.4, "self"), (0.6, "parent"), (0.8, "self")])
def test_a_kill_of_a_pool_changes_no_byte(work, whole, share, victim):
    points, digest, _ = whole
    struck, found = killed_at(work, "pool", round(share * points), victim)
    assert struck and found == digest


@pytest.mark.parametrize("seed", range(3))
def test_a_kill_at_any_moment_changes_no_byte(work, whole, seed):
    _, digest, seconds = whole
    assert killed_after(work, "pool", random.Random(seed).uniform(0.3, 1.0) * seconds)[1] == digest
