"""Claims about shape calibration: its derivatives, and what it makes of a model that is wrong."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handtrack.calibrate import calibrate
from handtrack.calibrate_buried import SHARE, buried_shares
from handtrack.calibrate_couplings import with_coupled_tips
from handtrack.cli import main
from handtrack.errors import InputError
from handtrack.formats.model_writing import write_model
from handtrack.formats.models import read_model
from handtrack.kinematics import forward, link_ends
from handtrack.link_shape import (
    PARAMETERS,
    factor_of,
    reshaped,
    shape_root,
    shape_rows,
    shape_sigmas,
    sigmas_from_covariance,
)
from handtrack.measure import posed
from handtrack.profiles import outside, place_outline
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


@pytest.mark.parametrize("wrong", [1.05, 0.95])
def test_a_wrong_radius_is_found_and_the_pose_gets_right(wrong):
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
    off = np.abs(found.link_radius / scene.model.link_radius - 1.0)
    assert off.mean() < 0.012 and off.max() < 0.04
    assert all(sigmas is not None and sigmas.radius[0] > 0.0 for sigmas in found.link_sigmas)
    assert picture.stat().st_size > 10_000


def test_a_picture_without_the_hand_is_refused(tmp_path, capsys):
    scene = two_finger_crossing(2, frames=3, size=(160, 120), scale=0.8)
    write_sequence(tmp_path / "in", scene)
    for path in (tmp_path / "in").rglob("*.png"):
        cv2.imwrite(str(path), np.zeros((120, 160), np.uint8))
    assert main(["calibrate-shape", str(tmp_path / "in"), "--out", str(tmp_path / "m.yaml")]) == 2
    assert "enough edges" in capsys.readouterr().err and not (tmp_path / "m.yaml").exists()


def _quick(frames=16):
    scene = two_finger_crossing(2, frames=frames, size=(320, 240), scale=1.6)
    return scene, replace(scene.model, link_radius=1.05 * scene.model.link_radius)


def test_the_whole_covariance_of_the_shape_comes_back_from_a_file_bit_for_bit(tmp_path):
    scene = two_finger_crossing(1, frames=2)
    rng = np.random.default_rng(1)
    root = 0.1 * rng.normal(size=(42, 42))
    factor = factor_of(root @ root.T + 0.01 * np.eye(42))
    known = replace(scene.model, shape_factor=factor, link_sigmas=sigmas_from_covariance(factor @ factor.T))
    write_model(tmp_path / "m.yaml", known)
    again = read_model(tmp_path / "m.yaml")
    np.testing.assert_array_equal(again.shape_factor, factor)
    np.testing.assert_array_equal(shape_root(again), factor)
    np.testing.assert_allclose(factor @ factor.T, root @ root.T + 0.01 * np.eye(42), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.rsplit("\n", 2)[0] + "\n", "rows; 42 rows of 1 to 42 numbers"),
        (lambda text: text.replace("\n  - [0.5]", "\n  - [-0.5]"), "negative on the diagonal"),
        (lambda text: text.replace("\n  - [0.5]", "\n  - [0.6]"), "differs from the `sigmas` of frame"),
        (lambda text: text.replace("\n  - [0.5]", "\n  - [.inf]"), "number"),
    ],
)
def test_a_shape_factor_that_is_no_factor_is_refused(change, said, tmp_path):
    scene = two_finger_crossing(1, frames=2)
    factor = 0.5 * np.eye(42)
    known = replace(scene.model, shape_factor=factor, link_sigmas=sigmas_from_covariance(factor @ factor.T))
    write_model(tmp_path / "m.yaml", known)
    (tmp_path / "m.yaml").write_text(change((tmp_path / "m.yaml").read_text()))
    with pytest.raises(InputError, match=said):
        read_model(tmp_path / "m.yaml")


def test_a_factor_follows_its_links_when_the_file_lists_children_first(tmp_path):
    scene = two_finger_crossing(1, frames=2)
    rng = np.random.default_rng(2)
    factor = factor_of(np.diag(rng.uniform(0.01, 0.2, 42)) + 0.005)
    known = replace(scene.model, shape_factor=factor, link_sigmas=sigmas_from_covariance(factor @ factor.T))
    write_model(tmp_path / "m.yaml", known)
    lines = (tmp_path / "m.yaml").read_text().splitlines()
    rows = [i for i, line in enumerate(lines) if line.startswith("  - {id:")]
    linked = [i for i in rows if "link:" in lines[i]]
    order = np.arange(len(linked))[::-1]
    swapped = lines.copy()
    for to, of in zip(linked, order, strict=True):
        swapped[to] = lines[linked[of]]
    at = (7 * order[:, None] + np.arange(7)).ravel()
    turned = np.linalg.cholesky((factor @ factor.T)[np.ix_(at, at)])
    begin = swapped.index("shape_factor:")
    body = [f"  - {list(map(float, row[: i + 1]))}" for i, row in enumerate(turned)]
    (tmp_path / "m.yaml").write_text("\n".join([*swapped[: begin + 1], *body]) + "\n")
    again = read_model(tmp_path / "m.yaml")
    assert again.shape_factor is not None
    ids = [model.frame_ids[model.link_frame].tolist() for model in (scene.model, again)]
    there = np.array([ids[0].index(one) for one in ids[1]])
    at = (7 * there[:, None] + np.arange(7)).ravel()
    np.testing.assert_allclose(
        again.shape_factor @ again.shape_factor.T, (factor @ factor.T)[np.ix_(at, at)], atol=1e-12
    )
    np.testing.assert_array_equal(np.triu(again.shape_factor, 1), 0.0)


def test_after_calibration_the_pose_is_right_and_its_covariance_covers_the_error():
    scene = two_finger_crossing(0, frames=32)
    pictures = list(images(scene))
    shape = np.zeros((6, PARAMETERS))
    shape[:, 0] = -0.03 * scene.model.link_length
    settings = Settings(hypotheses=False)
    found = calibrate(pictures, reshaped(scene.model, shape), [scene.camera], scene.start, settings=settings)
    run = track(pictures, found.model, scene.camera, scene.start, settings=settings)
    error = run.q - scene.truth
    assert np.sqrt((error**2).mean(axis=0)).max() < np.radians(0.4)
    squared = np.mean([e @ np.linalg.solve(C, e) for e, C in zip(error, run.covariance, strict=True)])
    assert 0.8 < squared < 9.0  # six joints
    off = (found.shape + shape).ravel()
    assert off @ np.linalg.solve(found.covariance, off) < 2.5 * off.size


def test_edges_of_a_palm_that_the_model_lacks_are_found_out():
    scene = two_finger_crossing(1, frames=2)
    on, u = chain(scene.model, scene.camera), scene.truth[0]
    samplers = place_outline(posed(on, u), scene.camera, scene.model.link_is_tip)
    first = (scene.model.link_parent[samplers.link] < 0) & (samplers.along < SHARE)

    def shares(off):
        ray, slope = in_world(scene.camera, samplers.ray + off[:, None] * samplers.slope, samplers.slope)
        features = OutlineFeatures(ray, slope, samplers.link, np.full(first.size, 0.2))
        return buried_shares(on, [(features, u)] * 10)

    assert shares(np.full(first.size, 0.3)) is None
    np.testing.assert_array_equal(shares(np.where(first, 2.0, 0.3)), SHARE * (scene.model.link_parent < 0))


def test_a_buried_share_is_kept_by_files_and_not_looked_at(tmp_path):
    scene = two_finger_crossing(1, frames=2)
    write_model(tmp_path / "m.yaml", replace(scene.model, link_buried=SHARE * (scene.model.link_parent < 0)))
    model = read_model(tmp_path / "m.yaml")
    on, u = chain(model, scene.camera), scene.truth[0]
    assert model.link_buried is not None
    samplers = outside(place_outline(posed(on, u), scene.camera, model.link_is_tip), model.link_buried)
    first = (model.link_parent[samplers.link] < 0) & (samplers.side != 0)
    assert samplers.along[first].min() >= SHARE > samplers.along[~first].min()


def test_last_joints_are_coupled_through_the_start_pose():
    model = two_finger_crossing(1, frames=2).model
    start = np.radians(np.linspace(5.0, 40.0, 6))
    coupled = with_coupled_tips(model, start, 0.1)
    np.testing.assert_allclose(coupled.soft @ start[coupled.free], coupled.soft_target, atol=1e-12)
    moved = start.copy()
    for joint, by in (("index_pip", 0.3), ("index_dip", 0.2)):
        moved[model.joint_names.index(joint)] += by
    np.testing.assert_allclose(coupled.soft @ moved[coupled.free], coupled.soft_target, atol=1e-12)
    with pytest.raises(ValueError, match="no free joints"):
        with_coupled_tips(coupled, start, 0.1)


def test_tracking_with_calibrate_writes_the_better_model_into_the_run(tmp_path, capsys):
    scene, wrong = _quick()
    write_sequence(tmp_path / "in", scene)
    write_model(tmp_path / "wrong.yaml", wrong)
    given = ["track", str(tmp_path / "in"), "--model", str(tmp_path / "wrong.yaml"), "--out", str(tmp_path / "run")]
    assert main([*given, "--calibrate", "8"]) == 0
    found = read_model(tmp_path / "run" / "model.yaml")
    off = np.abs(found.link_radius / scene.model.link_radius - 1.0)
    assert off.mean() < 0.012 and off.max() < 0.04 and found.shape_factor is not None
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["calibrated_on"] == 8 and "calibrated on 8 frames" in record["warnings"][-1]
    assert "calibrated on 8 frames" in (tmp_path / "run" / "report.html").read_text()
    assert main([*given, "--calibrate", "1"]) == 2
    assert "2 frames or more" in capsys.readouterr().err


def test_a_coupling_without_a_width_is_refused(tmp_path, capsys):
    scene, _ = _quick(3)
    write_sequence(tmp_path / "in", scene)
    given = ["calibrate-shape", str(tmp_path / "in"), "--out", str(tmp_path / "m.yaml"), "--couple-tips", "0"]
    assert main(given) == 2
    assert "--couple-tips: 0" in capsys.readouterr().err
