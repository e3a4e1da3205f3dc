"""Claims about shape calibration: its derivatives, and what it makes of a model that is wrong."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from handtrack.calibrate import calibrate
from handtrack.cli import main
from handtrack.formats.model_writing import write_model
from handtrack.formats.models import read_model
from handtrack.kinematics import forward, link_ends
from handtrack.link_shape import PARAMETERS, reshaped, shape_rows, shape_sigmas
from handtrack.measure import posed
from handtrack.profiles import place_outline
from handtrack.residuals import OutlineFeatures, chain, in_world, outline_residuals
from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scenes import images, two_finger_crossing
from synth.sequence import write_sequence


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
def test_shape_rows_are_finite_differences_of_the_residuals(projection):
    scene = two_finger_crossing(1, frames=2, projection=projection)
    rng = np.random.default_rng(0)
    model = reshaped(scene.model, rng.normal(0.0, 0.4, (6, PARAMETERS)))
    on, u = chain(model, scene.camera), scene.truth[0]
    samplers = place_outline(posed(on, u), scene.camera, model.link_is_tip)
    ray, slope = in_world(scene.camera, samplers.ray, samplers.slope)
    features = OutlineFeatures(ray, slope, samplers.link, rng.uniform(0.1, 0.3, samplers.link.size))
    H = shape_rows(model, features, u)
    for column in range(6 * PARAMETERS):
        shape = np.zeros((6, PARAMETERS))
        shape.flat[column] = 1e-5
        ahead, behind = (
            outline_residuals(chain(reshaped(model, s * shape), scene.camera), features, u)[0] for s in (1, -1)
        )
        numeric = (ahead - behind) / 2e-5
        np.testing.assert_allclose(H[:, column], numeric, atol=3e-4 * max(1.0, np.abs(numeric).max()))


def test_a_longer_link_carries_what_sits_on_it():
    model = two_finger_crossing(1, frames=2).model
    shape = np.zeros((6, PARAMETERS))
    shape[0, 0] = 2.0
    q = np.full(6, 0.2)
    (base, tip), (_, longer) = (link_ends(m, forward(m, q)) for m in (model, reshaped(model, shape)))
    heading = (tip[0] - base[0]) / np.linalg.norm(tip[0] - base[0])
    np.testing.assert_allclose(longer[:3] - tip[:3], np.tile(2.0 * heading, (3, 1)), atol=1e-9)
    np.testing.assert_allclose(longer[3:], tip[3:], atol=1e-12)


@pytest.mark.parametrize(("kind", "wrong"), [("radius", 1.05), ("radius", 0.95)])
def test_a_wrong_radius_is_found_and_the_pose_gets_right(kind, wrong):
    scene = two_finger_crossing(4, frames=32)
    pictures = list(images(scene))
    model = replace(scene.model, link_radius=wrong * scene.model.link_radius)
    settings = Settings(hypotheses=False)
    found = calibrate(pictures, model, [scene.camera], scene.start, settings=settings)
    sigma = shape_sigmas(found.model).reshape(-1, PARAMETERS)[:, 1:3]
    error = found.model.link_radius - scene.model.link_radius
    assert np.abs(error).max() < 0.25 * np.abs(model.link_radius - scene.model.link_radius).max()
    assert (np.abs(error) < 4.0 * sigma + 0.05).all()
    assert found.residual_after < found.residual_before

    def worst(with_model):
        q = track(pictures, with_model, scene.camera, scene.start, settings=settings).q
        return np.sqrt(((q - scene.truth) ** 2).mean(axis=0)).max()

    assert worst(found.model) < np.radians(0.5) < worst(model)


def test_the_command_writes_a_model_that_is_read_back_and_a_picture(tmp_path):
    scene = two_finger_crossing(2, frames=8, size=(320, 240), scale=1.6)
    wrong = replace(scene, model=replace(scene.model, link_radius=1.05 * scene.model.link_radius))
    write_sequence(tmp_path / "in", scene)
    write_model(tmp_path / "wrong.yaml", wrong.model)
    out, picture = tmp_path / "right.yaml", tmp_path / "outlines.png"
    given = [str(tmp_path / "in"), "--model", str(tmp_path / "wrong.yaml"), "--out", str(out), "--plot", str(picture)]
    assert main(["calibrate-shape", *given]) == 0
    found = read_model(out)
    assert np.abs(found.link_radius / scene.model.link_radius - 1.0).max() < 0.03
    assert all(sigmas is not None and sigmas.radius[0] > 0.0 for sigmas in found.link_sigmas)
    assert picture.stat().st_size > 10_000


def test_a_picture_without_the_hand_is_refused(tmp_path, capsys):
    scene = two_finger_crossing(2, frames=3, size=(160, 120), scale=0.8)
    write_sequence(tmp_path / "in", scene)
    for path in (tmp_path / "in").rglob("*.png"):
        cv2.imwrite(str(path), np.zeros((120, 160), np.uint8))
    assert main(["calibrate-shape", str(tmp_path / "in"), "--out", str(tmp_path / "m.yaml")]) == 2
    assert "enough edges" in capsys.readouterr().err and not (tmp_path / "m.yaml").exists()
