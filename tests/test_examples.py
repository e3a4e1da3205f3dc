"""Claims about the examples: each runs as it stands, draws its picture, and stays short enough to read."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("[0-9][0-9]_*.py"))


def test_examples_are_numbered_without_repeats_and_start_with_the_basics():
    numbers = [example.name[:2] for example in EXAMPLES]
    assert numbers[:5] == ["01", "02", "03", "04", "05"] and len(set(numbers)) == len(numbers)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_an_example_draws_its_picture(example, tmp_path):
    picture = tmp_path / "picture.png"
    environment = os.environ | {"MPLBACKEND": "Agg"}
    subprocess.run([sys.executable, example, "--out", picture], check=True, env=environment, cwd=tmp_path, timeout=120)
    assert picture.stat().st_size > 10_000
    assert len(example.read_text().splitlines()) < 80
