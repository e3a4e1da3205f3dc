"""Claims about tracking as a whole: accuracy, honest sigmas, loss, and what a wrong model does to both."""

from dataclasses import replace

import numpy as np
import pytest

from handtrack.kinematics import Coupling, Model, model_from_rows, pose_from_free
from handtrack.kinematics.tree import FrameRow
from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scenes import Scene, images, two_finger_crossing, two_finger_hard

FRAMES = 14


def crossing(seed: int, frames: int = FRAMES, **options) -> tuple[Scene, list[np.ndarray]]:
    scene = two_finger_crossing(seed, frames=frames, size=(320, 240), scale=1.6, **options)
    return scene, [np.asarray(image, dtype=np.float32) for image in images(scene)]


def follow(scene: Scene, frames: list[np.ndarray], model: Model | None = None, **settings):
    return track(frames, model or scene.model, scene.camera, scene.start, scene.fps, Settings(**settings))


def worst(found, scene: Scene) -> float:
    """RMSE of the worst joint, degrees."""
    return float(np.degrees(np.sqrt(((found.q - scene.truth[: len(found.q)]) ** 2).mean(axis=0))).max())


def nees(found, scene: Scene) -> float:
    """Mean NEES for each degree of freedom."""
    error = found.q - scene.truth
    return float(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error).mean() / error.shape[1])


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
def test_a_crossing_at_half_size_is_followed_to_less_than_a_degree(projection):
    scene, frames = crossing(3, projection=projection)
    found = follow(scene, frames)
    assert worst(found, scene) < 1.0
    assert (found.status == "tracked").all()


def test_fast_fingers_in_noise_are_followed_from_a_wrong_start():
    scene = two_finger_hard(5, frames=FRAMES)
    found = follow(scene, [np.asarray(image, dtype=np.float32) for image in images(scene)])
    assert worst(found, scene) < 0.5


@pytest.mark.parametrize(
    "choice",
    [
        {"solver": "gauss-newton"},
        {"solver": "gauss-newton-one"},
        {"solver": "damped"},
        {"solver": "trust-region"},
        {"filter": "ghk"},
        {"filter": "none"},
        {"visibility": "polygons"},
        {"interpolation": "bicubic"},
        {"interpolation": "nearest"},
        {"residuals": "lines"},
        {"residuals": "lines", "visibility": "polygons"},
        {"residuals": "lines", "templates": "first"},
    ],
    ids=lambda choice: "-".join(choice.values()),
)
def test_every_choice_follows_a_short_crossing(choice):
    scene, frames = crossing(4, frames=8)
    found = follow(scene, frames, **choice)
    assert worst(found, scene) < (3.0 if "residuals" in choice else 1.0)
    assert np.isfinite(found.sigma).all()


def test_the_same_images_give_the_same_track():
    scene, frames = crossing(1, frames=4)
    one, two = follow(scene, frames), follow(scene, frames)
    assert one.q.tobytes() == two.q.tobytes() and one.covariance.tobytes() == two.covariance.tobytes()


def test_black_frames_are_lost_with_growing_sigma_and_tracking_resumes():
    scene, frames = crossing(2)
    hidden = [image if not 6 <= i < 9 else np.zeros_like(image) for i, image in enumerate(frames)]
    found = follow(scene, hidden)
    assert (found.status[6:9] == "lost").all()
    assert (np.diff(found.sigma[5:9].max(axis=1)) > 0).all()
    assert found.status[-1] == "tracked"
    assert np.degrees(np.abs(found.q[-1] - scene.truth[-1])).max() < 1.0


@pytest.mark.parametrize("level", [0.0, 90.0])
def test_an_image_that_shows_nothing_is_never_tracked(level):
    scene, frames = crossing(2, frames=4)
    rng = np.random.default_rng(0)
    empty = [np.float32(level) + rng.normal(0, 3, image.shape).astype(np.float32) for image in frames]
    found = follow(scene, empty)
    assert (found.status == "lost").all()
    assert np.isfinite(found.q).all() and np.isfinite(found.sigma).all()


def test_missing_frames_are_bridged():
    scene, frames = crossing(3)
    kept = [i for i in range(FRAMES) if i not in (6, 7, 8)]
    found = track(
        [frames[i] for i in kept], scene.model, scene.camera, scene.start, scene.fps, times=np.array(kept) / scene.fps
    )
    assert np.degrees(np.abs(found.q - scene.truth[kept])).max() < 1.0


@pytest.mark.parametrize(
    "change", [lambda x: 255.0 - x, lambda x: x + 60.0, lambda x: 0.3 * x], ids=["dark", "grey", "dim"]
)
def test_grey_levels_are_learnt_not_supposed(change):
    scene, frames = crossing(3)
    assert worst(follow(scene, [np.asarray(change(image), dtype=np.float32) for image in frames]), scene) < 1.0


def test_errors_are_as_large_as_sigmas_say():
    runs = [crossing(seed, noise=noise) for seed in range(4) for noise in (2.0, 6.0)]
    assert 0.5 < np.mean([nees(follow(scene, frames), scene) for scene, frames in runs]) < 1.5


@pytest.mark.parametrize(("length", "radius"), [(1.03, 1.0), (0.97, 1.0), (1.0, 1.03), (1.0, 0.97)])
def test_a_model_wrong_by_3_percent_inflates_sigma_enough(length, radius):
    scene, frames = crossing(0)
    right = follow(scene, frames)
    prefix = scene.model.prefix.copy()
    for link in np.flatnonzero(scene.model.link_parent >= 0):
        prefix[scene.model.link_frame[link], :3, 3] *= length
    wrong = replace(
        scene.model,
        prefix=prefix,
        link_length=scene.model.link_length * length,
        link_radius=scene.model.link_radius * radius,
    )
    found = follow(scene, frames, wrong)
    assert np.median(found.sigma) > 1.5 * np.median(right.sigma)
    assert nees(found, scene) < 3.0


def test_a_coupled_joint_follows_its_partner():
    scene, frames = crossing(3, frames=4)
    m = scene.model
    names = [None if j < 0 else m.joint_names[j] for j in m.joint]
    rows = [
        FrameRow(
            int(m.frame_ids[i]),
            int(m.frame_ids[m.parent[i]]) if m.parent[i] >= 0 else 0,
            transform=m.prefix[i],
            joint=names[i],
            link_length=float(m.link_length[links[0]]) if (links := np.flatnonzero(m.link_frame == i)).size else None,
            link_radius=tuple(m.link_radius[links[0]].tolist()) if links.size else None,
        )
        for i in range(m.frame_ids.size)
    ]
    model = model_from_rows("coupled", rows, [Coupling("index_dip", of="index_pip", ratio=0.5)])
    found = follow(scene, frames, model)
    pip, dip = m.joint_names.index("index_pip"), m.joint_names.index("index_dip")
    np.testing.assert_allclose(found.q[:, dip], 0.5 * found.q[:, pip], atol=1e-12)
    np.testing.assert_allclose(found.sigma[:, dip], 0.5 * found.sigma[:, pip], atol=1e-12)
    assert pose_from_free(model, found.q[0][model.free]).shape == (6,)


def test_poses_stay_within_the_limits():
    scene, frames = crossing(3, frames=6)
    limits = scene.model.limits.copy()
    limits[0] = (scene.truth[:, 0].max() - 0.3, scene.truth[:, 0].max() - 0.1)
    start = np.clip(scene.start, limits[:, 0], limits[:, 1])
    found = track(frames, replace(scene.model, limits=limits), scene.camera, start, scene.fps)
    assert (found.q >= limits[:, 0] - 1e-9).all() and (found.q <= limits[:, 1] + 1e-9).all()


def test_wrong_input_is_refused():
    scene, frames = crossing(3, frames=2)
    with pytest.raises(ValueError, match="start_pose: got 5 values"):
        track(frames, scene.model, scene.camera, scene.start[:5])
    with pytest.raises(ValueError, match="the camera has 320 x 240"):
        track([frames[0][:-1]], scene.model, scene.camera, scene.start)
    with pytest.raises(ValueError, match="no image to track"):
        track([], scene.model, scene.camera, scene.start)
