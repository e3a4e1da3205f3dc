"""Claims about the blur of edges: it is found from the image, and finding it keeps a blurred sequence accurate."""

import cv2
import numpy as np
import pytest

from handtrack.appearance import SHARP, learn
from handtrack.measure import look, posed
from handtrack.residuals import chain
from handtrack.settings import Settings
from handtrack.sharpness import learn_blur
from handtrack.tracker import track
from synth.scenes import images, two_finger_crossing


def blurred_image(scene, sigma):
    image = next(iter(images(scene))).astype(np.float32)
    return cv2.GaussianBlur(image, (0, 0), sigma) if sigma else image


@pytest.mark.parametrize(("sigma", "low", "high"), [(0.0, 0.4, 0.8), (1.0, 0.9, 1.5), (2.0, 1.4, 2.9)])
def test_the_blur_of_the_edges_is_found(sigma, low, high):
    scene = two_finger_crossing(2, frames=1)
    on, u = chain(scene.model, scene.camera), scene.truth[0]
    image = blurred_image(scene, sigma)
    appearance = learn(image, posed(on, u), scene.camera)
    for _ in range(3):
        seen = look(image, on, u, np.eye(6) * 1e-4, appearance, Settings())
        appearance = learn_blur(image, on, seen, appearance, Settings())
        appearance = learn(image, posed(on, u), scene.camera, appearance)
    assert low <= appearance.blur <= high


def test_an_image_without_edges_leaves_the_blur_alone():
    scene = two_finger_crossing(2, frames=1)
    on, u = chain(scene.model, scene.camera), scene.truth[0]
    appearance = learn(blurred_image(scene, 0.0), posed(on, u), scene.camera)
    black = np.zeros((480, 640), dtype=np.float32)
    seen = look(black, on, u, np.eye(6) * 1e-4, appearance, Settings())
    assert learn_blur(black, on, seen, appearance, Settings()).blur == SHARP


def test_a_blurred_sequence_is_followed_to_less_than_a_degree():
    scene = two_finger_crossing(3, frames=12)
    frames = [cv2.GaussianBlur(np.asarray(image, dtype=np.float32), (0, 0), 1.5) for image in images(scene)]
    found = track(frames, scene.model, scene.camera, scene.start, scene.fps)
    assert np.degrees(np.sqrt(((found.q - scene.truth) ** 2).mean(axis=0))).max() < 0.8
