"""The hand loop: images in, a track out. One step reads like the picture of the method:

predict -> (look -> fit) until the pose rests -> weigh it against its rivals -> learn the appearance -> filter
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .appearance import Appearance, learn
from .camera import Camera
from .consistency import Consistency, first_consistency
from .estimate import Estimate, Known, estimate
from .hypotheses import Rival, Verdict, corrected, differ, judge
from .kinematics import Model
from .measure import posed, visible_share
from .measure_lines import first_profiles
from .prediction import Prediction, first_prediction, predict
from .residuals import Chain, chain
from .settings import Settings
from .sharpness import learn_blur
from .synthesis import Unmodelled
from .track import LOST, TRACKED, UNCERTAIN, Track
from .width import widths_in_views

Image = Float[np.ndarray, "_h _w"]

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
    appearance : tuple of Appearance, or None
        Grey levels of surface and background in each view, once a frame was seen.
    consistency : Consistency
        Scatter of the edges and error of the shape.
    stored : tuple of (n, m) or None
        Profiles of the first frame in each view, where these are the templates.
    widen, frames : float, int
        Factor on the next search range, and number of frames seen.
    rivals : tuple of Rival
        Other poses that the images so far cannot tell from the tracked one.
    unmodelled : tuple of Unmodelled
        What refinement has learnt of errors of surface and shape in each view; empty before.
    """

    prediction: Prediction
    appearance: tuple[Appearance, ...] | None
    consistency: Consistency
    stored: tuple[Float[np.ndarray, "n m"] | None, ...]
    widen: float
    frames: int
    rivals: tuple[Rival, ...] = ()
    unmodelled: tuple[Unmodelled, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One tracked frame: all joints, with the state of the evidence, and the likeliest rival with its weight."""

    q: Float[np.ndarray, " j"]
    covariance: Float[np.ndarray, "j j"]
    unseen: Bool[np.ndarray, " k"]
    estimate: Estimate
    status: str
    confidence: float
    other: Float[np.ndarray, " j"] | None = None
    other_weight: float = 0.0


def track(
    frames: Iterable[Image | Sequence[Image]],
    model: Model,
    camera: Camera | Sequence[Camera],
    start_pose: Float[np.ndarray, " j"],
    fps: float = 25.0,
    settings: Settings | None = None,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Track a model through images.

    Parameters
    ----------
    frames : iterable of (h, w) arrays, or of tuples of them
        Grey levels 0 to 255; with several cameras a tuple at a time, one image for each camera.
    camera : Camera or sequence of Camera
        One for each view; all in the same world, frame {0} of the model.
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
    cameras = [camera] if isinstance(camera, Camera) else camera
    on = [chain(model, each) for each in cameras]
    moments, seconds, done = [], [], []
    for number, (now, took, frame) in enumerate(follow(frames, on, start_pose, fps, settings or Settings(), times)):
        moments.append(now)
        seconds.append(took)
        done.append(_kept(frame, on))
        if progress is not None:
            progress(number + 1)
    if not done:
        raise ValueError("frames: there is no image to track")
    columns = [np.stack(column) for column in zip(*done, strict=True)]
    q, covariance, information, status, confidence, residual, visible, edges, rival, weight, *width = columns
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return Track(
        joint_names=model.joint_names,
        frame=np.arange(len(done)),
        time=np.array(moments),
        q=q,
        sigma=sigma,
        covariance=covariance,
        information=information,
        status=status,
        confidence=confidence,
        residual=residual,
        visible=visible.max(axis=1),
        edges=edges.sum(axis=1),
        seconds=np.array(seconds),
        view_edges=edges,
        view_visible=visible,
        rival=rival,
        rival_weight=weight,
        width=width[0],
        width_sigma=width[1],
        width_lasting=width[2],
        width_profiles=width[3],
    )


def follow(
    frames: Iterable[Image | Sequence[Image]],
    on: Sequence[Chain],
    start_pose: Float[np.ndarray, " j"],
    fps: float,
    settings: Settings,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
) -> Iterator[tuple[float, float, Frame]]:
    """Track frame by frame: time, computing time in seconds, and everything known of the frame.

    Nothing is kept from one frame to the next but the `State`, so memory stays flat however long the sequence.
    """
    state, before = begin(on, start_pose, fps, settings), 0.0
    for number, images in enumerate(frames):
        now = float(times[number]) if times is not None else number / fps
        begun = time.perf_counter()
        together = (images,) if isinstance(images, np.ndarray) else images
        state, frame = step(state, together, on, now - before if number else 0.0, settings)
        yield now, time.perf_counter() - begun, frame
        before = now


def begin(on: Sequence[Chain], start_pose: Float[np.ndarray, " j"], fps: float, settings: Settings) -> State:
    """State before the first frame: the start pose, unknown velocities."""
    if not on:
        raise ValueError("camera: got no camera; one for each view is wanted")
    model = on[0].model
    if start_pose.shape != (len(model.joint_names),):
        wanted = f"{len(model.joint_names)} joints of model '{model.name}'"
        raise ValueError(f"start_pose: got {start_pose.size} values, wanted the {wanted}")
    u = start_pose[model.free]
    prediction = first_prediction(u, fps, settings)
    return State(prediction, None, first_consistency(u.size), (None,) * len(on), 1.0, 0)


def step(
    state: State, images: Sequence[Image], on: Sequence[Chain], dt: float, settings: Settings
) -> tuple[State, Frame]:
    """One moment in all views: predict, look and fit until the pose rests, learn the appearance, filter."""
    _check(images, on)
    ahead = predict(state.prediction, dt)
    passes = settings.passes + (_START_PASSES if state.frames < _START_FRAMES else 0)
    appearance = state.appearance or _learn(images, on, ahead.motion.q, (None,) * len(on))
    known = Known(tuple(on), settings, appearance, state.consistency, state.stored, state.unmodelled)
    first = state.appearance is None
    if first:  # templates learnt at a pose that is only supposed would confirm it; outlines hardly depend on them
        plain = replace(settings, residuals="outline", edges="wssd", templates="rendered", refine=False)
        known = replace(known, settings=plain)
    found = estimate(images, known, ahead.motion, ahead.motion.q, passes, state.widen)
    if first:
        appearance = _learn(images, on, found.u, appearance)
        appearance = _learn_blur(images, on, found, appearance, settings)
        known = Known(tuple(on), settings, appearance, state.consistency, state.stored, state.unmodelled)
        found = estimate(images, known, ahead.motion, found.u, passes, found.widen)
    verdict = Verdict(found, ahead, found.covariance, (), np.zeros((0, found.u.size)), None, 0.0)
    if settings.hypotheses and settings.residuals == "outline":
        verdict = judge(images, known, ahead, found, state.rivals, dt, passes)
    found = verdict.found
    taught = found.information.any() and not verdict.rivals  # what rivals look like is for them to tell apart
    if taught and (state.frames < _YOUNG or state.frames % 3 == 0):
        appearance = _learn(images, on, found.u, appearance)
        if state.frames < _START_FRAMES or state.frames % _BLUR_EVERY == 0:
            appearance = _learn_blur(images, on, found, appearance, settings)
    following = corrected(verdict.ahead, found, verdict.close)
    stored = state.stored
    if settings.templates == "first" and stored[0] is None:
        views = zip(images, on, appearance, strict=True)
        stored = tuple(first_profiles(image, view, found.u, its, settings) for image, view, its in views)
    widen = max(1.0, 0.8 * found.widen)
    frame = _frame(on[0], verdict, following)
    done = state.frames + 1
    return State(following, appearance, found.consistency, stored, widen, done, verdict.rivals, found.unmodelled), frame


def _check(images: Sequence[Image], on: Sequence[Chain]) -> None:
    if len(images) != len(on):
        raise ValueError(f"image: got {len(images)} images for {len(on)} cameras; one for each is wanted")
    for image, view in zip(images, on, strict=True):
        if image.shape != (view.camera.height, view.camera.width):
            wanted = f"{view.camera.width} x {view.camera.height}"
            raise ValueError(f"image: got {image.shape[1]} x {image.shape[0]} pixels, the camera has {wanted}")


def _learn(
    images: Sequence[Image],
    on: Sequence[Chain],
    u: Float[np.ndarray, " k"],
    previous: Sequence[Appearance | None],
) -> tuple[Appearance, ...]:
    """The appearance in each view, with the pose u taken for true."""
    views = zip(images, on, previous, strict=True)
    return tuple(learn(image, posed(view, u), view.camera, its) for image, view, its in views)


def _learn_blur(
    images: Sequence[Image], on: Sequence[Chain], found: Estimate, appearance: Sequence[Appearance], settings: Settings
) -> tuple[Appearance, ...]:
    if settings.residuals != "outline" or settings.edges != "wssd":
        return tuple(appearance)
    views = zip(images, on, found.seen, appearance, strict=True)
    return tuple(learn_blur(image, view, seen, its, settings) for image, view, seen, its in views)


def _frame(on: Chain, verdict: Verdict, following: Prediction) -> Frame:
    found, C = verdict.found, on.model.coupling
    covariance = C @ (verdict.covariance + found.consistency.shape_covariance) @ C.T
    q = C @ found.u + on.model.coupling_offset
    other = None if verdict.other is None else C @ verdict.other + on.model.coupling_offset
    doubtful = following.unseen.any() or (verdict.other is not None and differ(on.model, found.u, verdict.other))
    expected = sum(int(view.expected.sum()) for view in found.seen)
    share = (
        sum(int(view.found.sum()) for view in found.seen) / expected if expected and found.information.any() else 0.0
    )
    known = UNCERTAIN if share < _UNCERTAIN_BELOW or doubtful else TRACKED
    status = LOST if share < _LOST_BELOW else known
    confidence = share * (1.0 - 0.5 * float(following.unseen.mean()))
    return Frame(q, covariance, following.unseen, found, status, confidence, other, verdict.other_weight)


def _kept(frame: Frame, on: Sequence[Chain]) -> tuple[np.ndarray | str | float | int, ...]:
    """What the track keeps of a frame; the looks at the images are let go."""
    seen, model = frame.estimate.seen, on[0].model
    visible = np.array([visible_share(view.samplers, view.edges, model.link_frame.size) for view in seen])
    edges = np.array([int(view.found.sum()) for view in seen])
    image_only, residual = frame.estimate.information, frame.estimate.residual
    rival = np.full(frame.q.size, np.nan) if frame.other is None else frame.other
    sure = frame.status, frame.confidence
    widths = widths_in_views(seen, [view.pills for view in seen], model.link_radius)  # a pixel's motion cancels
    width = widths.width, widths.sigma, widths.lasting, widths.profiles
    return frame.q, frame.covariance, image_only, *sure, residual, visible, edges, rival, frame.other_weight, *width
