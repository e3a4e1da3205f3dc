"""The hand loop: images in, a track out. One step reads like the picture of the method:

predict -> (look -> fit) until the pose rests -> learn the appearance -> filter
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .appearance import Appearance, learn
from .camera import Camera
from .consistency import Consistency, first_consistency
from .estimate import Estimate, Known, estimate
from .kinematics import Model
from .measure import posed, visible_share
from .measure_lines import first_profiles
from .prediction import Prediction, correct, first_prediction, predict
from .residuals import Chain, chain
from .settings import Settings
from .sharpness import learn_blur
from .track import LOST, TRACKED, UNCERTAIN, Track

_LOST_BELOW, _UNCERTAIN_BELOW = 0.4, 0.7  # share of the expected edges that was found
_YOUNG = 8  # frames after which the appearance is learnt on every third one
_BLUR_EVERY = 16
_START_FRAMES, _START_PASSES = 3, 4  # more looks while the velocity is not known


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What the tracker carries from frame to frame.

    Attributes
    ----------
    prediction : Prediction
        Filtered pose and motion, ready to predict the next frame.
    appearance : Appearance or None
        Grey levels of surface and background, once a frame was seen.
    consistency : Consistency
        Scatter of the edges and error of the shape.
    stored : (n, m) or None
        Profiles of the first frame, where these are the templates.
    widen, frames : float, int
        Factor on the next search range, and number of frames seen.
    """

    prediction: Prediction
    appearance: Appearance | None
    consistency: Consistency
    stored: Float[np.ndarray, "n m"] | None
    widen: float
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One tracked frame: all joints, with the state of the evidence."""

    q: Float[np.ndarray, " j"]
    covariance: Float[np.ndarray, "j j"]
    unseen: Bool[np.ndarray, " k"]
    estimate: Estimate
    status: str
    confidence: float


def track(
    frames: Iterable[Float[np.ndarray, "h w"]],
    model: Model,
    camera: Camera,
    start_pose: Float[np.ndarray, " j"],
    fps: float = 25.0,
    settings: Settings | None = None,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Track a model through images.

    Parameters
    ----------
    frames : iterable of (h, w) arrays
        Grey levels 0 to 255.
    start_pose : (j,)
        Joint values in the first frame, radians; a few degrees off is fine.
    fps, times : float, (n,)
        Frame rate, or the time of each frame in seconds.
    progress : callable
        Called with the number of frames done.

    Raises
    ------
    ValueError
        For a start pose of the wrong length, images of another size than the camera's, or no image at all.
    """
    settings = settings or Settings()
    on = chain(model, camera)
    state = begin(on, start_pose, fps, settings)
    done, moments, seconds = [], [], []
    for number, image in enumerate(frames):
        now = float(times[number]) if times is not None else number / fps
        begun = time.perf_counter()
        state, frame = step(state, image, on, now - moments[-1] if moments else 0.0, settings)
        seconds.append(time.perf_counter() - begun)
        done.append(frame)
        moments.append(now)
        if progress is not None:
            progress(number + 1)
    if not done:
        raise ValueError("frames: there is no image to track")
    return _collect(on, done, moments, seconds)


def begin(on: Chain, start_pose: Float[np.ndarray, " j"], fps: float, settings: Settings) -> State:
    """State before the first frame: the start pose, unknown velocities."""
    if start_pose.shape != (len(on.model.joint_names),):
        wanted = f"{len(on.model.joint_names)} joints of model '{on.model.name}'"
        raise ValueError(f"start_pose: got {start_pose.size} values, wanted the {wanted}")
    u = start_pose[on.model.free]
    return State(first_prediction(u, fps, settings), None, first_consistency(u.size), None, 1.0, 0)


def step(
    state: State, image: Float[np.ndarray, "h w"], on: Chain, dt: float, settings: Settings
) -> tuple[State, Frame]:
    """One frame: predict, look and fit until the pose rests, learn the appearance, filter."""
    if image.shape != (on.camera.height, on.camera.width):
        wanted = f"{on.camera.width} x {on.camera.height}"
        raise ValueError(f"image: got {image.shape[1]} x {image.shape[0]} pixels, the camera has {wanted}")
    ahead = predict(state.prediction, dt)
    passes = settings.passes + (_START_PASSES if state.frames < _START_FRAMES else 0)
    appearance = state.appearance or learn(image, posed(on, ahead.motion.q), on.camera)
    known = Known(on, settings, appearance, state.consistency, state.stored)
    first = state.appearance is None
    if first:  # templates learnt at a pose that is only supposed would confirm it; outlines hardly depend on them
        known = replace(known, settings=replace(settings, residuals="outline", templates="rendered"))
    found = estimate(image, known, ahead.motion, ahead.motion.q, passes, state.widen)
    if first:
        appearance = learn(image, posed(on, found.u), on.camera, appearance)
        appearance = learn_blur(image, on, found.seen, appearance, settings)
        known = Known(on, settings, appearance, state.consistency, state.stored)
        found = estimate(image, known, ahead.motion, found.u, passes, found.widen)
    if found.information.any() and (state.frames < _YOUNG or state.frames % 3 == 0):
        appearance = learn(image, posed(on, found.u), on.camera, appearance)
        if settings.residuals == "outline" and (state.frames < _START_FRAMES or state.frames % _BLUR_EVERY == 0):
            appearance = learn_blur(image, on, found.seen, appearance, settings)
    following = correct(ahead, found.u, found.information)
    stored = state.stored
    if settings.templates == "first" and stored is None:
        stored = first_profiles(image, on, found.u, appearance, settings)
    widen = max(1.0, 0.8 * found.widen)
    frame = _frame(on, found, following)
    return State(following, appearance, found.consistency, stored, widen, state.frames + 1), frame


def _frame(on: Chain, found: Estimate, following: Prediction) -> Frame:
    C = on.model.coupling
    covariance = C @ (found.covariance + found.consistency.shape_covariance) @ C.T
    expected = int(found.seen.expected.sum())
    share = float(found.seen.found.sum()) / expected if expected and found.information.any() else 0.0
    if share < _LOST_BELOW:
        status = LOST
    else:
        status = UNCERTAIN if share < _UNCERTAIN_BELOW or following.unseen.any() else TRACKED
    confidence = share * (1.0 - 0.5 * float(following.unseen.mean()))
    return Frame(C @ found.u + on.model.coupling_offset, covariance, following.unseen, found, status, confidence)


def _collect(on: Chain, done: list[Frame], moments: list[float], seconds: list[float]) -> Track:
    links = on.model.link_frame.size
    covariance = np.stack([frame.covariance for frame in done])
    seen = [frame.estimate.seen for frame in done]
    return Track(
        joint_names=on.model.joint_names,
        frame=np.arange(len(done)),
        time=np.array(moments),
        q=np.stack([frame.q for frame in done]),
        sigma=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        covariance=covariance,
        status=np.array([frame.status for frame in done]),
        confidence=np.array([frame.confidence for frame in done]),
        residual=np.array([frame.estimate.residual for frame in done]),
        visible=np.stack([visible_share(look.samplers, look.edges, links) for look in seen]),
        edges=np.array([int(look.found.sum()) for look in seen]),
        seconds=np.array(seconds),
    )
