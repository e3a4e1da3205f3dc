"""Tracking holds nothing of the frames that are past."""

import gc
import tracemalloc

import numpy as np

from handtrack.cli.memory import growth_mb, resident_mb, there_and_back
from handtrack.residuals import chain
from handtrack.settings import Settings
from handtrack.tracker import follow
from synth.scenes import images, two_finger_crossing


def test_memory_does_not_grow_with_the_number_of_frames():
    scene = two_finger_crossing(0, frames=12, scale=1.6, size=(320, 240))
    pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
    on, held = [chain(scene.model, scene.camera)], {}
    frames = follow(there_and_back(pictures, 120), on, scene.start, scene.fps, Settings())
    for _ in range(20):  # compiled code is loaded before anything is counted
        next(frames)
    tracemalloc.start()
    try:
        for number, _ in enumerate(frames, start=20):
            if number in (49, 119):
                gc.collect()
                held[number] = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    image = pictures[0].nbytes
    # What is cached of sampler layouts comes to an end; one look kept of each frame would be a hundred images.
    assert held[119] - held[49] < 0.3 * image


def test_frames_go_there_and_back_without_a_jump():
    pictures = [np.full((1, 1), number) for number in range(4)]
    order = np.array([frame[0, 0] for frame in there_and_back(pictures, 30)])
    assert order.size == 30 and set(order) == {0, 1, 2, 3}
    assert (np.abs(np.diff(order)) == 1).all()


def test_the_process_is_some_megabytes_and_hardly_grows_in_a_few_frames():
    assert 20.0 < resident_mb() < 1e5
    assert abs(growth_mb(40, sequence=10)) < 200.0


def test_where_the_system_does_not_tell_the_most_ever_held_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr("handtrack.cli.memory._STATM", tmp_path / "none")
    assert 20.0 < resident_mb() < 1e5
