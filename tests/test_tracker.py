"""The hand loop as its user sees it: it follows, says how sure it is, and says when it sees nothing."""

import math
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from handtrack.kinematics import Coupling, FrameRow, Model, model_from_rows
from handtrack.prediction import predict
from handtrack.residuals import chain
from handtrack.settings import Settings
from handtrack.track import LOST, TRACKED, Track
from handtrack.tracker import begin, step, track
from synth.scene import Scene, images
from synth.scenes import random_motion, two_finger_crossing

SOLVERS = ("levenberg-marquardt", "gauss-newton", "gauss-newton-one", "damped", "trust-region")
WAYS = {
    **{f"outline {name}": Settings(solver=name) for name in SOLVERS},
    **{f"lines {name}": Settings(residuals="lines", solver=name) for name in (SOLVERS[0], "gauss-newton-one")},
    "g-h-k filter": Settings(filter="ghk"),
    "no filter": Settings(filter="none"),
    "polygons": Settings(visibility="polygons"),
    "lines, polygons": Settings(residuals="lines", visibility="polygons"),
    "nearest": Settings(interpolation="nearest"),
    "bicubic": Settings(interpolation="bicubic"),
    "first templates": Settings(residuals="lines", templates="first"),
    "one look": Settings(passes=1),
    "sparse": Settings(spacing=20.0),
}
SMALL = (320, 240)


@cache
def shot(seed: int, frames: int = 12, **options) -> tuple[Scene, tuple[np.ndarray, ...]]:
    """A crossing at half the size, and its images."""
    scene = two_finger_crossing(seed, frames=frames, **{"size": SMALL, "scale": 1.6, **options})
    return scene, tuple(images(scene))


@cache
def followed(seed: int, settings: Settings | None = None, frames: int = 12, **options) -> tuple[Scene, Track]:
    scene, pictures = shot(seed, frames, **options)
    return scene, track(pictures, scene.model, scene.camera, scene.start, settings=settings)


def degrees_off(found: Track, truth: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs(found.q - truth))


def rms(found: Track, truth: np.ndarray) -> float:
    """Root mean square error of the worst joint, degrees."""
    return float(np.sqrt((degrees_off(found, truth) ** 2).mean(axis=0)).max())


def nees(found: Track, truth: np.ndarray) -> float:
    """Mean of e^T C^-1 e over the frames for each degree of freedom; 1 where the covariance is exact."""
    e = found.q - truth
    return float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.covariance), e).mean()) / e.shape[1]


def scaled(model: Model, length: float = 1.0, radius: float = 1.0) -> Model:
    """The model with all links longer, the next ones attached at their new ends, and thicker."""
    prefix = model.prefix.copy()
    prefix[np.isin(model.parent, model.link_frame), :3, 3] *= length
    return replace(model, link_length=length * model.link_length, link_radius=radius * model.link_radius, prefix=prefix)


@pytest.mark.parametrize(("seed", "projection"), [(1, "orthographic"), (2, "perspective")])
def test_a_crossing_is_followed_to_half_a_degree_at_the_worst_joint(seed, projection):
    scene, found = followed(seed, projection=projection, size=(640, 480), scale=3.2)
    assert rms(found, scene.truth) < 0.35 and degrees_off(found, scene.truth).max() < 0.7
    assert (found.status == TRACKED).all() and (found.confidence > 0.8).all()


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
def test_lines_and_tips_follow_a_crossing_to_two_degrees(projection):
    scene, found = followed(2, Settings(residuals="lines"), frames=10, projection=projection)
    assert degrees_off(found, scene.truth).max() < 2.0


@pytest.mark.parametrize("way", WAYS)
def test_every_way_of_tracking_follows_an_easy_sequence(way):
    scene, found = followed(3, WAYS[way], frames=6, max_speed=1.5)
    assert rms(found, scene.truth) < 1.5
    assert (found.status == TRACKED).mean() > 0.7 and (found.status != LOST).all()


def test_solvers_that_minimise_one_cost_find_one_track():
    tracks = [followed(3, WAYS[f"outline {name}"], frames=6, max_speed=1.5)[1] for name in SOLVERS]
    np.testing.assert_allclose(tracks[4].q, tracks[0].q, atol=math.radians(0.02))  # both minimise the robust cost
    np.testing.assert_allclose(tracks[3].q, tracks[1].q, atol=math.radians(0.1))  # both reweigh once


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_start_wrong_by_three_degrees_is_repaired_in_the_first_frame(seed):
    scene, found = followed(seed, start_error=3.0)
    assert np.degrees(np.abs(scene.start - scene.truth[0])).min() > 2.9
    first = degrees_off(found, scene.truth)[0]
    assert first.max() < 1.8
    assert (first < 3.0 * np.degrees(found.sigma[0])).all()
    assert rms(found, scene.truth) < 1.2


def test_black_frames_are_lost_with_growing_sigma_and_tracking_resumes():
    scene, pictures = shot(1, 16, max_speed=1.0)
    black = range(6, 11)
    blinking = [np.zeros_like(picture) if n in black else picture for n, picture in enumerate(pictures)]
    found = track(blinking, scene.model, scene.camera, scene.start)
    assert (found.status == np.where(np.isin(found.frame, black), LOST, TRACKED)).all()
    assert (np.diff(found.sigma[5:11], axis=0) > 0.0).all()
    assert (found.confidence[6:11] == 0.0).all() and (found.edges[6:11] == 0).all()
    assert degrees_off(found, scene.truth)[11:].max() < 1.5
    assert (found.sigma[11:] < 0.5 * found.sigma[10]).all()
    assert (degrees_off(found, scene.truth) < 3.5 * np.degrees(found.sigma) + 0.1).all()


def nothing(kind: str) -> np.ndarray:
    """An image without a hand."""
    width, height = SMALL
    y, x = np.mgrid[:height, :width].astype(np.float32)
    rng = np.random.default_rng(5)
    return {
        "black": np.zeros_like(x),
        "white": np.full_like(x, 255.0),
        "dim noise": rng.normal(50.0, 2.0, x.shape).astype(np.float32),
        "noise": rng.uniform(0.0, 255.0, x.shape).astype(np.float32),
        "sideways ramp": 255.0 * x / width,
        "ramp": 255.0 * y / height,
        "chequers": 255.0 * ((x // 8 + y // 8) % 2),
        "stripes": 255.0 * (y // 12 % 2),
    }[kind]


NOTHING = ("black", "white", "dim noise", "noise", "sideways ramp", "ramp", "chequers", "stripes")


@pytest.mark.parametrize("kind", NOTHING)
def test_an_image_that_shows_nothing_is_never_tracked(kind):
    scene, _ = shot(1)
    found = track([nothing(kind)] * 3, scene.model, scene.camera, scene.start)
    assert (found.status != TRACKED).all()
    assert_well_formed(found, 3, scene.model)
    if kind != "stripes":  # along the fingers, these have edges to find
        assert (found.status == LOST).all() and (np.degrees(found.sigma.max(axis=1)) > 2.0).all()


@pytest.mark.parametrize("kind", ["black", "noise", "ramp", "stripes"])
def test_lines_call_an_image_that_shows_nothing_never_tracked(kind):
    scene, _ = shot(1)
    settings = Settings(residuals="lines", passes=2)
    found = track([nothing(kind)] * 2, scene.model, scene.camera, scene.start, settings=settings)
    assert (found.status != TRACKED).all()
    assert_well_formed(found, 2, scene.model)


def assert_well_formed(found: Track, n: int, model: Model) -> None:
    joints, links = len(model.joint_names), model.link_frame.size
    shapes = {
        "frame": (n,),
        "time": (n,),
        "q": (n, joints),
        "sigma": (n, joints),
        "covariance": (n, joints, joints),
        "status": (n,),
        "confidence": (n,),
        "residual": (n,),
        "visible": (n, links),
        "edges": (n,),
        "seconds": (n,),
    }
    for name, shape in shapes.items():
        values = getattr(found, name)
        assert values.shape == shape, name
        assert values.dtype.kind == "U" or np.isfinite(values).all(), name
    assert found.joint_names == model.joint_names
    for share in (found.visible, found.confidence):
        assert (share >= 0.0).all() and (share <= 1.0).all()
    assert (found.sigma > 0.0).all() and (found.seconds > 0.0).all() and (found.residual >= 0.0).all()
    np.testing.assert_allclose(found.covariance, np.swapaxes(found.covariance, 1, 2), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.sigma**2, np.diagonal(found.covariance, axis1=1, axis2=2))
    assert (np.linalg.eigvalsh(found.covariance) > -1e-15).all()


@pytest.mark.parametrize("way", ["outline levenberg-marquardt", "first templates", "no filter"])
def test_a_track_is_complete_and_holds_no_nan(way):
    scene, found = followed(3, WAYS[way], frames=6, max_speed=1.5)
    assert_well_formed(found, 6, scene.model)
    np.testing.assert_array_equal(found.frame, np.arange(6))
    np.testing.assert_allclose(found.time, np.arange(6) / 25.0)


def test_the_same_input_gives_the_same_bytes():
    scene, pictures = shot(1)
    found = [track(pictures, scene.model, scene.camera, scene.start) for _ in range(2)]
    for field in fields(Track):
        if field.name not in ("seconds", "joint_names"):
            one, two = (getattr(track, field.name) for track in found)
            assert one.tobytes() == two.tobytes(), field.name


def test_frames_are_taken_one_by_one_and_reported():
    scene, pictures = shot(1)
    calls, taken = [], []

    def stream():
        for number, picture in enumerate(pictures[:4]):
            taken.append((number, len(calls)))
            yield picture

    track(stream(), scene.model, scene.camera, scene.start, progress=calls.append)
    assert calls == [1, 2, 3, 4] and taken == [(0, 0), (1, 1), (2, 2), (3, 3)]


def test_a_track_depends_on_no_later_frame():
    scene, pictures = shot(1)
    part = track(pictures[:5], scene.model, scene.camera, scene.start)
    whole = followed(1)[1]
    np.testing.assert_array_equal(part.q, whole.q[:5])
    np.testing.assert_array_equal(part.covariance, whole.covariance[:5])


def test_even_times_are_the_frame_rate():
    scene, pictures = shot(1)
    timed = track(pictures, scene.model, scene.camera, scene.start, fps=25.0, times=np.arange(12) / 25.0)
    np.testing.assert_array_equal(timed.q, followed(1)[1].q)
    np.testing.assert_array_equal(timed.time, np.arange(12) / 25.0)


@pytest.mark.parametrize("filter_", ["kalman", "ghk", "none"])
def test_gaps_in_the_times_are_bridged(filter_):
    scene, pictures = shot(2, 24, max_speed=2.0)
    kept = np.array([0, 1, 2, 3, 4, 5, 9, 10, 11, 12, 16, 17, 18, 19, 22, 23])
    found = track(
        [pictures[n] for n in kept],
        scene.model,
        scene.camera,
        scene.start,
        settings=Settings(filter=filter_),
        times=kept / 25.0,
    )
    np.testing.assert_allclose(found.time, kept / 25.0)
    assert (found.status == TRACKED).all() and rms(found, scene.truth[kept]) < 1.0


def test_after_a_longer_gap_the_prediction_is_less_sure():
    scene, pictures = shot(1)
    on = (chain(scene.model, scene.camera),)
    state = begin(on, scene.start, 25.0, Settings())
    for number in range(4):
        state, _ = step(state, (pictures[number],), on, 0.04 if number else 0.0, Settings())
    spread = [np.diag(predict(state.prediction, dt).motion.covariance) for dt in (0.04, 0.08, 0.4)]
    assert (np.diff(spread, axis=0) > 0.0).all()


@pytest.mark.parametrize("noise", [2.0, 6.0])
def test_the_covariance_covers_the_error(noise):
    values = []
    for seed in range(1, 6):
        scene, found = followed(seed, noise=noise)
        values.append(nees(found, scene.truth))
    assert 0.5 < np.mean(values) < 1.6
    assert max(values) < 2.5


@pytest.mark.parametrize(
    ("noise", "wrong"),
    [(2.0, (1.03, 1.0)), (2.0, (0.97, 1.0)), (2.0, (1.0, 1.03)), (2.0, (1.0, 0.97)), (6.0, (1.03, 1.0))],
)
def test_a_model_wrong_by_three_per_cent_inflates_sigma_enough(noise, wrong):
    values, growth = [], []
    for seed in (1, 2):
        scene, pictures = shot(seed, noise=noise)
        right = followed(seed, noise=noise)[1]
        found = track(pictures, scaled(scene.model, *wrong), scene.camera, scene.start)
        values.append(nees(found, scene.truth))
        growth.append(found.sigma[2:].mean() / right.sigma[2:].mean())
    assert np.mean(values) < 3.0
    assert min(growth) > 2.0


def test_inverted_contrast_is_followed():
    scene, pictures = shot(1)
    found = track([255.0 - picture for picture in pictures], scene.model, scene.camera, scene.start)
    assert (found.status == TRACKED).all() and rms(found, scene.truth) < 0.8


@pytest.mark.parametrize(
    "background",
    [
        pytest.param(lambda x, y: 250.0 + 0.0 * x, id="white"),
        pytest.param(lambda x, y: 120.0 + 100.0 * x / 320.0 + 30.0 * np.sin(y / 60.0), id="lit from a side"),
        pytest.param(lambda x, y: 200.0 + 30.0 * np.sin(x / 80.0) * np.cos(y / 50.0), id="wavy"),
    ],
)
def test_a_smooth_bright_background_is_followed(background):
    scene, _ = shot(2)
    y, x = np.mgrid[:240, :320].astype(float)
    bright = replace(scene, background=background(x, y))
    found = track(images(bright), scene.model, scene.camera, scene.start)
    assert (found.status != LOST).all() and rms(found, scene.truth) < 1.0


@cache
def coupled() -> tuple[Scene, tuple[np.ndarray, ...]]:
    """Two fingers whose last joints follow the ones before, as tendons make them."""
    rows, couplings = [], []
    for number, (name, y) in enumerate((("a", -18.0), ("b", 18.0))):
        first, half = 3 * number + 1, math.pi / 2
        place = np.eye(4)
        place[1, 3] = y
        rows += [
            FrameRow(100 + first, 0, transform=place),
            FrameRow(
                first, 100 + first, joint=f"{name}_mcp", limits=(-0.6, 0.6), link_length=46.0, link_radius=(9.0, 8.0)
            ),
            FrameRow(
                first + 1,
                first,
                half,
                46.0,
                joint=f"{name}_pip",
                limits=(0.1, 1.2),
                link_length=27.0,
                link_radius=(8.0, 8.0),
            ),
            FrameRow(first + 2, first + 1, 0.0, 27.0, joint=f"{name}_dip", link_length=20.0, link_radius=(8.0, 7.0)),
        ]
        couplings.append(Coupling(f"{name}_dip", f"{name}_pip", 0.67, 0.05))
    scene = random_motion(4, model_from_rows("coupled", rows, couplings), frames=8, size=SMALL, max_speed=2.0)
    return scene, tuple(images(scene))


@pytest.mark.parametrize("way", ["outline levenberg-marquardt", "outline trust-region", "lines levenberg-marquardt"])
def test_a_coupled_joint_follows_its_partner_exactly(way):
    scene, pictures = coupled()
    found = track(pictures, scene.model, scene.camera, scene.start, settings=WAYS[way])
    pip, dip = ([scene.model.joint_names.index(f"{f}_{part}") for f in "ab"] for part in ("pip", "dip"))
    np.testing.assert_allclose(found.q[:, dip], 0.67 * found.q[:, pip] + 0.05, atol=1e-12)
    np.testing.assert_allclose(found.sigma[:, dip], 0.67 * found.sigma[:, pip], rtol=1e-9)
    assert (found.status == TRACKED).all() and rms(found, scene.truth) < 2.0


@pytest.mark.parametrize("way", [name for name in WAYS if name.startswith("outline")])
def test_joint_limits_hold(way):
    scene, pictures = shot(1, 8, max_speed=6.0)
    joint = int(np.argmax(np.ptp(scene.truth, axis=0)))
    limits = scene.model.limits.copy()
    middle = float(scene.truth[:, joint].mean())
    side = 1 if scene.truth[0, joint] < middle else 0  # the start is inside, the end beyond
    limits[joint, side] = middle
    model = replace(scene.model, limits=limits)
    found = track(pictures, model, scene.camera, scene.start, settings=WAYS[way])
    assert (found.q >= limits[:, 0]).all() and (found.q <= limits[:, 1]).all()
    beyond = np.abs(scene.truth[:, joint] - found.q[:, joint]) > math.radians(1.0)
    assert beyond.any() and np.allclose(found.q[-1, joint], middle, atol=1e-9)


def test_the_finger_in_front_hides_the_one_behind():
    scene, found = followed(1, frames=24)
    finger = scene.model.link_finger
    front = found.visible[:, finger == finger[-1]]
    behind = found.visible[:, finger == finger[0]]
    assert front.min() == 1.0 and behind.min() < 0.8 and behind.max() == 1.0


def test_an_image_of_another_size_is_refused():
    scene, pictures = shot(1)
    with pytest.raises(ValueError, match="image: got 319 x 240 pixels, the camera has 320 x 240"):
        track([pictures[0], pictures[1][:, 1:]], scene.model, scene.camera, scene.start)


@pytest.mark.parametrize("joints", [0, 5, 7])
def test_a_start_pose_of_the_wrong_length_is_refused(joints):
    scene, pictures = shot(1)
    with pytest.raises(ValueError, match=f"start_pose: got {joints} values, wanted the 6 joints of model"):
        track(pictures, scene.model, scene.camera, np.zeros(joints))


def test_no_image_at_all_is_refused():
    scene, _ = shot(1)
    with pytest.raises(ValueError, match="frames: there is no image to track"):
        track([], scene.model, scene.camera, scene.start)
