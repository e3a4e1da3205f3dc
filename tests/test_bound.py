"""The smooth image against its twin and the exact renderer; the bound against laws and an estimator that attains it."""

import importlib.util
import json
import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from handtrack.appearance import SHARP, Appearance
from handtrack.bound import Bounds, bounds, image_information, least_sigma, link_twists, spread_frames, usual_sigma
from handtrack.camera import Camera, orthographic, perspective
from handtrack.cli import main
from handtrack.cli.rendering import write_scene
from handtrack.evaluate import as_json, as_text, evaluate
from handtrack.kinematics import Coupling, FrameRow, forward, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, pose_pills
from handtrack.report.bounds import error_figure, error_table
from handtrack.residuals import chain
from handtrack.sequences import Truth
from handtrack.settings import Settings
from handtrack.soft_image import cover_numpy, soft_image, soft_image_numpy
from handtrack.track import Track
from handtrack.tracker import track
from synth.render import render
from synth.scene import images
from synth.scenes import two_finger_crossing
from synth.shading import Light, Material

ROOT = Path(__file__).resolve().parent.parent
TOWARDS = np.array([-0.5, -0.6, -0.8]) / np.linalg.norm([-0.5, -0.6, -0.8])
FLAT = orthographic(40, 30, 1.3, 20.0, 15.0, np.eye(3), np.zeros(3))
BENT = perspective(
    40, 30, 250.0, 260.0, 20.0, 15.0, np.eye(3), np.zeros(3), distortion=np.array([0.3, -0.2, 0.01, 0.02, 0.1])
)
# Three tapered pills: two that meet in a crease, one that crosses in front; the image cuts two of them off.
THREE = Pills(
    np.array([[-12.0, -2.0, 200.0], [4.5, 3.2, 201.0], [-6.0, 8.0, 190.0]]),
    np.array([[4.0, 3.0, 203.0], [14.0, -4.0, 196.0], [7.0, -9.0, 188.0]]),
    np.array([[4.5, 4.0], [4.0, 3.2], [3.0, 3.5]]),
)


def matt(links, albedo=200.0, noise=2.0, blur=SHARP):
    """A surface of ambient and diffuse light, which the appearance holds exactly, and its material and light."""
    shading = np.zeros(28)
    shading[0], shading[25:] = 0.25 * albedo, 0.65 * albedo * TOWARDS
    look = Appearance(shading, np.ones(links), 5.0, noise, blur, noise, np.zeros((26, 26)), np.zeros(26))
    return look, Material(np.full((links, 3), albedo), 0.25, 0.65, 0.0, 12.0), Light(TOWARDS)


def mottled(blur=SHARP):
    """An appearance with every coefficient in use."""
    shading = 8.0 * np.random.default_rng(0).normal(size=28)
    shading[0], shading[25:] = 120.0, [-40.0, -50.0, -60.0]
    gain = np.array([1.0, 0.9, 1.1])
    return Appearance(shading, gain, 20.0, 1.0, blur, 1.0, np.zeros((26, 26)), np.zeros(26))


def turned(pills, link, twist):
    """Pills with one of them moved by a small twist about its base."""
    base, tip = pills.base.copy(), pills.tip.copy()
    R = cv2.Rodrigues(twist[3:])[0]
    tip[link] = base[link] + twist[:3] + R @ (tip[link] - base[link])
    base[link] = base[link] + twist[:3]
    return Pills(base, tip, pills.radius)


def rows_by_difference(pills, camera, look, h=1e-6, **options):
    """Derivatives of the twin's image by the twists of all links."""
    return np.stack(
        [
            (
                soft_image_numpy(turned(pills, k, h * e), camera, look, **options)
                - soft_image_numpy(turned(pills, k, -h * e), camera, look, **options)
            ).ravel()
            / (2.0 * h)
            for k in range(pills.base.shape[0])
            for e in np.eye(6)
        ]
    )


def relative(found, wanted):
    """Largest difference of two information matrices, in units of the wanted one's diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(wanted), 1e-9 * np.diag(wanted).max()))
    return np.abs((found - wanted) * scale * scale[:, None]).max()


def pills_of(model, camera, q):
    return pose_pills(model, forward(model, q), camera)


def small_crossing(projection="orthographic", **options):
    return two_finger_crossing(3, projection=projection, size=(320, 240), scale=1.6, **options)


@pytest.mark.parametrize("blur", [SHARP, 1.2])
@pytest.mark.parametrize("camera", [FLAT, BENT], ids=["orthographic", "bent"])
def test_smooth_image_is_that_of_its_numpy_twin(camera, blur):
    look = mottled(blur)
    soft = soft_image(THREE, camera, look, block=1)
    np.testing.assert_allclose(soft.image, soft_image_numpy(THREE, camera, look), atol=1e-9)


SMALLER = orthographic(28, 21, 0.91, 14.0, 10.5, np.eye(3), np.zeros(3))
SMALLER_BENT = replace(BENT, width=28, height=21, fx=175.0, fy=182.0, cx=14.0, cy=10.5)


@pytest.mark.parametrize(("camera", "blur"), [(SMALLER, 1.0), (SMALLER_BENT, SHARP)], ids=["orthographic", "bent"])
def test_information_on_motion_is_that_of_differences_of_the_image(camera, blur):
    look = mottled(blur)
    soft = soft_image(THREE, camera, look, block=1)
    rows = rows_by_difference(THREE, camera, look, edges_of=THREE)
    assert relative(soft.motion, rows @ rows.T) < 1e-4


def test_information_on_light_gains_and_background_is_that_of_differences_of_the_image():
    look, h, small = mottled(), 1e-3, orthographic(17, 14, 0.56, 8.5, 7.0, np.eye(3), np.zeros(3))
    soft = soft_image(THREE, small, look, block=1, light=True)

    def column(change):
        up, down = (soft_image_numpy(THREE, small, replace(look, **change(s * h))) for s in (1.0, -1.0))
        return (up - down).ravel() / (2.0 * h)

    rows = [column(lambda s, e=e: {"shading": look.shading + s * e}) for e in np.eye(28)]
    rows += [column(lambda s, e=e: {"gain": look.gain + s * e}) for e in np.eye(3)]
    rows = np.stack([*rows, column(lambda s: {"background": look.background + s})])
    assert relative(soft.light, rows @ rows.T) < 1e-6
    motion = rows_by_difference(THREE, small, look, edges_of=THREE)
    np.testing.assert_allclose(soft.cross, motion @ rows.T, atol=1e-4 * np.abs(soft.cross).max())


def test_fine_squares_and_blocks_change_the_information_by_a_per_cent():
    scene = small_crossing(frames=12)
    look, *_ = matt(6)
    pills = pills_of(scene.model, scene.camera, scene.truth[11])
    G = link_twists(chain(scene.model, scene.camera), forward(scene.model, scene.truth[11]))

    def information(**options):
        return G.T @ soft_image(pills, scene.camera, look, **options).motion @ G

    every = information(block=1, fine=3)
    assert relative(information(), every) < 0.03
    assert relative(information(fine=2), every) < 0.02


def test_share_of_a_square_is_the_area_that_the_edge_leaves():
    rng = np.random.default_rng(5)
    angle, d = rng.uniform(0, 2 * np.pi, 40), rng.uniform(-0.9, 0.9, 40)
    edge = np.column_stack([np.cos(angle), np.sin(angle)])
    u, v = (np.mgrid[:400, :400] + 0.5) / 400 - 0.5
    inside = [np.mean(u * n[0] + v * n[1] < -distance) for n, distance in zip(edge, d, strict=True)]
    np.testing.assert_allclose(cover_numpy(d, edge, 1.0, 0.0), inside, atol=2e-3)
    blurred = cover_numpy(d, edge, 1.0, 3.0)
    np.testing.assert_allclose(blurred, [0.5 * math.erfc(x / math.hypot(3.0, 0.2887) / 2**0.5) for x in d], atol=1e-4)


@pytest.mark.parametrize(
    ("projection", "lens", "off"), [("orthographic", 0.0, 0.1), ("perspective", 0.0, 0.1), ("perspective", 0.6, 0.3)]
)
def test_bound_is_that_of_differences_of_the_exact_renderer(projection, lens, off):
    # The oracle: exact images, four times as fine and averaged over pixels, at poses a few microradians apart.
    scene = small_crossing(projection, frames=30)
    camera, model, q, n, h = scene.camera, scene.model, scene.truth[29], 4, 5e-4
    look, material, light = matt(6, blur=math.hypot(SHARP, lens))
    fine = Camera(
        camera.kind,
        camera.width * n,
        camera.height * n,
        camera.fx * n,
        camera.fy * n,
        (camera.cx + 0.5) * n - 0.5,
        (camera.cy + 0.5) * n - 0.5,
        camera.R,
        camera.t,
        camera.distortion,
    )

    def exact(q):
        image = render(pills_of(model, fine, q), fine, material, light, background=5.0).astype(float)
        if lens:
            image = cv2.GaussianBlur(image, (0, 0), lens * n)
        return image.reshape(camera.height, n, camera.width, n).mean(axis=(1, 3))

    rows = np.stack([((exact(q + h * e) - exact(q - h * e)) / (2.0 * h)).ravel() for e in np.eye(6)])
    F = image_information(chain(model, camera), q, look)
    np.testing.assert_allclose(np.diag(F), np.diag(rows @ rows.T) / look.noise**2, rtol=0.04)
    np.testing.assert_allclose(least_sigma(model, F), least_sigma(model, rows @ rows.T / look.noise**2), rtol=0.04)
    soft = soft_image(pills_of(model, camera, q), camera, look, block=1, fine=3).image
    assert np.sqrt(np.mean((soft - exact(q)) ** 2)) < off


def test_twists_of_links_are_how_their_ends_move():
    rows = [
        FrameRow(1, 0, theta=math.pi / 2),
        FrameRow(2, 1, alpha=math.pi / 2, joint="slide", prismatic=True),
        FrameRow(3, 2, alpha=-math.pi / 2, joint="turn", link_length=5.0, link_radius=(1.0, 1.0)),
        FrameRow(
            4,
            3,
            a=5.0,
            alpha=0.7,
            joint="bend",
            link_length=4.0,
            link_radius=(1.0, 0.8),
            link_base_offset=(1.0, 2.0, 3.0),
        ),
    ]
    model = model_from_rows("slider", rows)
    camera = perspective(64, 48, 90.0, 90.0, 32.0, 24.0, cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0], np.full(3, 9.0))
    on, q, h = chain(model, camera), np.array([2.0, 0.4, -0.3]), 1e-6
    pills = pills_of(model, camera, q)
    G = link_twists(on, forward(model, q)).reshape(2, 2, 3, 3)
    tip = G[:, 0] + np.cross(G[:, 1], (pills.tip - pills.base)[:, :, None], axis=1)
    for j, e in enumerate(np.eye(3)):
        up, down = pills_of(model, camera, q + h * e), pills_of(model, camera, q - h * e)
        np.testing.assert_allclose(G[:, 0, :, j], (up.base - down.base) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(tip[:, :, j], (up.tip - down.tip) / (2 * h), atol=1e-6)


def single_link():
    """One link that swings in the image and tips out of it."""
    rows = [
        FrameRow(1, 0, joint="swing"),
        FrameRow(2, 1, alpha=math.pi / 2, joint="tip", link_length=14.0, link_radius=(4.0, 3.0)),
    ]
    camera = orthographic(56, 40, 2.0, 12.0, 18.0, np.eye(3), np.array([0.0, 0.0, 100.0]))
    return chain(model_from_rows("single", rows), camera), np.array([0.15, 0.5])


def test_least_squares_on_the_smooth_image_attains_the_bound():
    on, q = single_link()
    look, *_ = matt(1, noise=4.0)

    def picture(q):
        return soft_image(pills_of(on.model, on.camera, q), on.camera, look, block=1).image.ravel()

    h, rng, found = 1e-5, np.random.default_rng(7), []
    J = np.stack([(picture(q + h * e) - picture(q - h * e)) / (2.0 * h) for e in np.eye(2)], axis=1)
    step = np.linalg.pinv(J)
    clean = picture(q)
    for _ in range(200):
        noisy, u = clean + look.noise * rng.standard_normal(clean.size), q
        for _ in range(3):
            u = u + step @ (noisy - picture(u))
        found.append(u - q)
    scatter = np.std(found, axis=0)
    np.testing.assert_allclose(scatter, least_sigma(on.model, image_information(on, q, look)), rtol=0.1)


def test_bound_grows_with_the_noise_and_shrinks_with_the_root_of_equal_views():
    on, q = single_link()
    look, *_ = matt(1)
    F = image_information(on, q, look)
    one = least_sigma(on.model, F)
    np.testing.assert_allclose(least_sigma(on.model, image_information(on, q, replace(look, noise=6.0))), 3.0 * one)
    np.testing.assert_allclose(least_sigma(on.model, F + F), one / math.sqrt(2.0))


def test_not_knowing_the_light_can_only_cost():
    scene = small_crossing(frames=3)
    on, (look, *_) = chain(scene.model, scene.camera), matt(6)
    known = least_sigma(scene.model, image_information(on, scene.truth[2], look))
    unknown = least_sigma(scene.model, image_information(on, scene.truth[2], look, known_light=False))
    assert (unknown > known).all()
    assert (unknown < 2.0 * known).all()


def test_joint_that_the_image_cannot_see_has_no_bound_and_the_others_keep_theirs():
    # The link that twists is a body of revolution about its own axis; the last finger is out of the image.
    rows = [
        FrameRow(1, 0, joint="swing", link_length=14.0, link_radius=(4.0, 3.0)),
        FrameRow(2, 1, alpha=math.pi / 2, theta=math.pi / 2),
        FrameRow(3, 2, alpha=math.pi / 2, joint="twist"),
        FrameRow(4, 3, theta=-math.pi / 2, alpha=-math.pi / 2, link_length=10.0, link_radius=(3.0, 3.0)),
        FrameRow(5, 0, a=500.0, joint="away", link_length=14.0, link_radius=(3.0, 3.0)),
    ]
    camera = orthographic(56, 40, 2.0, 12.0, 18.0, np.eye(3), np.array([0.0, 0.0, 100.0]))
    on = chain(model_from_rows("blind", rows), camera)
    sigma = least_sigma(on.model, image_information(on, np.array([0.15, 0.3, 0.2]), matt(3)[0]))
    assert np.isfinite(sigma[0])
    assert np.isinf(sigma[1:]).all()


def test_link_behind_the_camera_or_behind_another_link_tells_nothing():
    rows = [
        FrameRow(1, 0, joint="front", link_length=30.0, link_radius=(14.0, 14.0)),
        FrameRow(2, 0, transform=np.array([[1, 0, 0, 8.0], [0, 1, 0, 0], [0, 0, 1, 40.0], [0, 0, 0, 1]])),
        FrameRow(3, 2, joint="hidden", link_length=10.0, link_radius=(3.0, 3.0)),
        FrameRow(4, 0, transform=np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -200.0], [0, 0, 0, 1.0]])),
        FrameRow(5, 4, joint="behind", link_length=10.0, link_radius=(3.0, 3.0)),
    ]
    on = chain(
        model_from_rows("three", rows),
        perspective(64, 48, 90.0, 90.0, 20.0, 24.0, np.eye(3), np.array([0.0, 0.0, 120.0])),
    )
    sigma = least_sigma(on.model, image_information(on, np.array([0.1, 0.2, 0.3]), matt(3)[0]))
    assert np.isfinite(sigma[0])
    assert np.isinf(sigma[1:]).all()


def test_pixels_beyond_what_a_sensor_holds_tell_nothing():
    on, q = single_link()
    look, *_ = matt(1)
    glaring = replace(look, shading=np.append(400.0, np.zeros(27)), background=300.0)
    assert not image_information(on, q, glaring).any()
    assert image_information(on, q, replace(glaring, background=200.0)).any()


def test_coupled_joint_is_bounded_through_the_one_it_follows():
    rows = [
        FrameRow(1, 0, joint="pip", link_length=14.0, link_radius=(4.0, 3.0)),
        FrameRow(2, 1, a=14.0, joint="dip", link_length=9.0, link_radius=(3.0, 3.0)),
    ]
    model = model_from_rows("coupled", rows, [Coupling("dip", "pip", 0.5)])
    camera = orthographic(72, 40, 2.0, 12.0, 18.0, np.eye(3), np.array([0.0, 0.0, 100.0]))
    sigma = least_sigma(model, image_information(chain(model, camera), np.array([0.2, 0.1]), matt(2)[0]))
    assert sigma[1] == pytest.approx(0.5 * sigma[0])
    assert np.isinf(least_sigma(model, np.zeros((1, 1)))).all()


def test_frames_are_spread_from_the_first_to_the_last():
    assert spread_frames(7, 60).tolist() == list(range(7))
    chosen = spread_frames(1000, 60)
    assert chosen.size == 60 and chosen[0] == 0 and chosen[-1] == 999 and np.ptp(np.diff(chosen)) <= 1
    with pytest.raises(ValueError, match="most: got 0, wanted at least 1"):
        spread_frames(5, 0)


@pytest.fixture(scope="module")
def tracked():
    scene = small_crossing(frames=8)
    pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
    on, number = (chain(scene.model, scene.camera),), np.arange(8)
    found = bounds(((image,) for image in pictures), on, scene.truth, number)
    return (
        scene,
        pictures,
        found,
        {
            refine: track(pictures, scene.model, scene.camera, scene.start, settings=Settings(refine=refine))
            for refine in (False, True)
        },
    )


@pytest.mark.parametrize("refine", [False, True])
def test_honest_sigmas_stay_above_the_bound(tracked, refine):
    _, _, found, tracks = tracked
    assert (np.median(tracks[refine].sigma / found.sigma, axis=0) >= 1.0).all()


def test_noise_is_learnt_and_the_bound_is_of_the_order_of_hundredths_of_a_degree(tracked):
    scene, _, found, _ = tracked
    assert np.median(found.noise) == pytest.approx(scene.sensor.noise, rel=0.25)
    assert np.degrees(found.sigma).min() > 1e-4 and np.degrees(found.sigma).max() < 0.1


def test_two_views_are_better_than_either(tracked):
    scene, pictures, found, _ = tracked
    on = chain(scene.model, scene.camera)
    twice = bounds([(pictures[0], pictures[0])], (on, on), scene.truth[:1], np.arange(1))
    np.testing.assert_allclose(twice.sigma[0], found.sigma[0] / math.sqrt(2.0), rtol=1e-9)
    assert twice.noise.shape == (1, 2)


def test_bounds_refuse_gaps_in_the_truth_and_missing_images(tracked):
    scene, pictures, *_ = tracked
    on = (chain(scene.model, scene.camera),)
    with pytest.raises(ValueError, match="q: holds NaN; a whole pose was wanted for every frame"):
        bounds([(pictures[0],)], on, np.full((1, 6), np.nan), np.arange(1))
    with pytest.raises(ValueError, match="images: got 1, wanted one for each of 2 poses"):
        bounds([(pictures[0],)], on, scene.truth[:2], np.arange(2))
    with pytest.raises(ValueError, match="images: got 0"):
        bounds([], on, scene.truth[:2], np.arange(2))


def test_evaluation_gives_every_rmse_as_a_ratio_to_the_bound(tracked):
    scene, _, found, tracks = tracked
    truth = Truth(np.arange(8), scene.truth)
    result = evaluate(tracks[False], truth, scene.model, scene.camera)
    assert "bound" not in as_text(result) and json.loads(as_json(result))["bound"] is None
    result = replace(result, bounds=found)
    entry = json.loads(as_json(result))["joints"][2]
    assert entry["rmse_to_bound"] == pytest.approx(entry["rmse"] / entry["bound"])
    assert entry["bound"] == pytest.approx(np.degrees(np.median(found.sigma[:, 2])))
    assert entry["unseen_frames"] == 0
    assert "Cramer-Rao, median of 8 frames; noise" in as_text(result) and "light known" in as_text(result)


def test_unseen_joint_is_called_unseen_and_never_a_number(tracked):
    scene, _, found, tracks = tracked
    truth = Truth(np.arange(8), scene.truth)
    sigma = found.sigma.copy()
    sigma[:, 1], sigma[:3, 2] = np.inf, np.inf
    blind = replace(found, sigma=sigma)
    result = replace(evaluate(tracks[False], truth, scene.model, scene.camera), bounds=blind)
    line = next(line for line in as_text(result).splitlines() if line.startswith(scene.model.joint_names[1]))
    assert "unseen" in line and "nan" not in as_text(result) and "inf" not in as_text(result)
    entries = json.loads(as_json(result))["joints"]
    assert entries[1]["bound"] is None and entries[1]["rmse_to_bound"] is None and entries[1]["unseen_frames"] == 1.0
    assert entries[2]["bound"] is not None and entries[2]["unseen_frames"] == 0.375
    table = error_table(tracks[False], truth, scene.model, blind)
    assert "nan" not in table and "inf" not in table
    names = {
        text.get_text() for axes in error_figure(tracks[False], truth, scene.model, blind).axes for text in axes.texts
    }
    assert names == {"unseen: no bound"}


def test_usual_bound_is_the_median_also_between_two_infinities():
    sigma = np.array([[1.0, np.inf], [3.0, np.inf], [2.0, 1.0], [4.0, np.inf]])
    found = Bounds(np.arange(4), sigma, np.ones((4, 1)), True)
    assert usual_sigma(found).tolist() == [2.5, np.inf]
    three = Bounds(np.arange(3), sigma[:3], np.ones((3, 1)), True)
    assert usual_sigma(three).tolist() == [2.0, np.inf]


def test_table_of_errors_has_empty_cells_where_there_is_no_value():
    model = builtin_model("rr")
    q = np.radians([[10.0, 20.0], [11.0, 21.0]])
    sigma = np.full((2, 2), np.radians(0.5))
    run = Track(
        joint_names=model.joint_names,
        frame=np.arange(2),
        time=np.arange(2) / 25.0,
        q=q,
        sigma=sigma,
        covariance=sigma[:, :, None] ** 2 * np.eye(2),
        information=np.zeros((2, 2, 2)),
        status=np.array(["tracked", "tracked"]),
        confidence=np.ones(2),
        residual=np.ones(2),
        visible=np.ones((2, model.link_length.size)),
        edges=np.full(2, 5),
        seconds=np.full(2, 0.01),
    )
    truth = Truth(np.arange(2), np.radians([[9.0, 20.0], [11.0, np.nan]]))
    found = Bounds(np.array([1]), np.radians([[0.1, np.inf]]), np.ones((1, 1)), True)
    assert error_table(run, truth, model, found).splitlines() == [
        "frame," + ",".join(f"{name}_{what}" for name in model.joint_names for what in ("error", "sigma", "bound")),
        "0,1,0.5,,0,0.5,",
        "1,0,0.5,0.1,,0.5,",
    ]
    assert error_table(run, truth, model, None).splitlines()[2] == "1,0,0.5,,,0.5,"
    assert len(error_figure(run, truth, model, None).axes) == 2


@pytest.fixture(scope="module")
def clip_and_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bound")
    write_scene(folder / "clip", small_crossing(frames=4))
    assert main(["track", str(folder / "clip"), "--out", str(folder / "run")]) == 0
    return folder / "clip", folder / "run"


def test_evaluate_prints_bounds_and_writes_table_and_picture(clip_and_run, tmp_path, capsys):
    clip, run = clip_and_run
    capsys.readouterr()
    more = ["--csv", str(tmp_path / "evaluation.csv"), "--plot", str(tmp_path / "evaluation.png")]
    assert main(["evaluate", str(run), "--input", str(clip), "--bound-frames", "3", "--json", *more]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["bound"]["frames"] == [0, 2, 3] and document["bound"]["known_light"]
    assert all(entry["rmse_to_bound"] > 0.5 for entry in document["joints"])
    assert (tmp_path / "evaluation.csv").read_text().count("\n") == 5
    assert cv2.imread(str(tmp_path / "evaluation.png")) is not None
    assert main(["evaluate", str(run), "--input", str(clip), "--unknown-light", "--bound-frames", "1"]) == 0
    assert "light unknown" in capsys.readouterr().out


def test_evaluate_without_the_input_prints_the_rest_and_one_warning(clip_and_run, tmp_path, capsys):
    _, run = clip_and_run
    moved = shutil.copytree(run, tmp_path / "far" / "away" / "run")
    capsys.readouterr()
    assert main(["evaluate", str(moved)]) == 0
    said = capsys.readouterr()
    assert "NEES" in said.out and "bound" not in said.out
    assert [line[:31] for line in said.err.splitlines()] == ["warning: no Cramer-Rao bound: " + str(moved)[:1]]
    assert main(["evaluate", str(moved), "--bound-frames", "0"]) == 0
    assert capsys.readouterr().err == ""


def test_evaluate_refuses_an_input_that_is_not_the_runs(clip_and_run, tmp_path, capsys):
    clip, run = clip_and_run
    write_scene(tmp_path / "short", small_crossing(frames=2))
    capsys.readouterr()
    for source, wanted in (
        (tmp_path / "nothing", "no such file or folder"),
        (tmp_path / "short", "its input was wanted"),
    ):
        assert main(["evaluate", str(run), "--input", str(source)]) == 2
        assert wanted in capsys.readouterr().err
    for option in ("--csv", "--plot"):
        name = str(tmp_path / "no" / "x.png")
        assert main(["evaluate", str(run), "--input", str(clip), "--bound-frames", "1", option, name]) == 2
        assert f"error: {option}: " in capsys.readouterr().err


def test_evaluate_needs_a_whole_pose_for_the_bound(clip_and_run, tmp_path, capsys):
    clip, run = clip_and_run
    (tmp_path / "truth.csv").write_text("frame,index_mcp\n0,1\n1,2\n")
    capsys.readouterr()
    assert main(["evaluate", str(run), "--truth", str(tmp_path / "truth.csv"), "--input", str(clip)]) == 0
    assert "no frame has a true value for every joint" in capsys.readouterr().err


def test_frames_of_a_video_are_picked_in_passing(tmp_path, capsys):
    write_scene(tmp_path / "clip", small_crossing(frames=4), video=True)
    assert main(["track", str(tmp_path / "clip"), "--out", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    arguments = ["evaluate", str(tmp_path / "run"), "--input", str(tmp_path / "clip"), "--bound-frames", "2", "--json"]
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)["bound"]["frames"] == [0, 3]


def test_accuracy_benchmark_reports_every_scene_and_group(capsys):
    found = importlib.util.spec_from_file_location("accuracy", ROOT / "benchmarks" / "accuracy.py")
    assert found is not None and found.loader is not None
    accuracy = importlib.util.module_from_spec(found)
    sys.modules["accuracy"] = accuracy  # where dataclasses look for their module
    found.loader.exec_module(accuracy)
    command = ["--motions", "1", "--frames", "3", "--bound-frames", "1", "--json", "--wrong-radius", "2"]
    assert accuracy.main(command) == 0
    rows = json.loads(capsys.readouterr().out)["summary"]
    assert [(row["scene"], row["joints"]) for row in rows] == [
        ("two-finger-crossing", "all"),
        ("two-finger-hard", "all"),
        ("full-hand-spread", "fingers"),
        ("full-hand-spread", "thumb"),
    ]
    assert all(row["worst_rmse_to_bound"] > 1.0 for row in rows)
