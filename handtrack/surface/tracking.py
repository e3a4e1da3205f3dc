"""Images, a bound surface and a start pose in, a track out: the hand loop with a skin for the pills.

predict -> (look -> fit) until the edges rest -> align all pixels -> learn the appearance -> filter

The parts are those of `handtrack.tracker`: prediction, edge search, robust whitened fit, scatter and shape error; only
what they say of the shape comes from the surface.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ..camera import Camera
from ..estimate import Prior, prior_of
from ..fit import Fit, fit
from ..measure import visible_share
from ..prediction import Prediction, correct, first_prediction, predict
from ..residuals import Chain, Rows, chain, stack_rows
from ..scatter import Scatter, Whitener, first_scatter, learn_scatter, whitener
from ..settings import Settings
from ..shape_error import ShapeError, first_shape_error, learn_shape_error
from ..track import LOST, TRACKED, UNCERTAIN, Track
from .align import align
from .image import lens_blur
from .learning import learn_lens, learn_surface
from .look import SurfaceLook, surface_look
from .residuals import surface_rows, surface_shape_jacobian
from .shading import SurfaceAppearance, forgotten
from .skin import Surface

Image = Float[np.ndarray, "h w"]

_REST = 0.4  # pixels of motion of the outline at which the edges rest
_LEAST_ROWS = 3
_WIDEST = 8.0
_YOUNG, _EVERY = 8, 3  # frames after which the appearance is learnt on every third one
_LENS_EVERY = 16
_START_FRAMES, _START_PASSES = 3, 4  # more looks while the velocity is not known
_LOST_BELOW, _UNCERTAIN_BELOW = 0.4, 0.7  # share of the expected edges that was found, and of pixels that fit
_PLAIN_S, _PLAIN_TAU = 2.0, 0.1  # scatter that a right shape may show
_MEMORY = 0.85  # weight of earlier frames in the conflict
_FAR = 5.0  # sigmas of the edges in each joint: an alignment farther off has run away


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is carried from frame to frame: see `handtrack.tracker.State`."""

    prediction: Prediction
    appearance: tuple[SurfaceAppearance, ...] | None
    scatter: Scatter
    shape: ShapeError
    shape_covariance: Float[np.ndarray, "k k"]
    conflict: float
    widen: float
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A fitted frame: pose, what the images say of it, covariance from images and prediction, looks, fit and rows."""

    u: Float[np.ndarray, " k"]
    information: Float[np.ndarray, "k k"]
    covariance: Float[np.ndarray, "k k"]
    seen: tuple[SurfaceLook, ...]
    edges: Fit | None
    rows: Rows | None
    white: Whitener | None
    widen: float
    conflict: float | None = None
    fitting: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFrame:
    """One tracked frame: all joints, status, and the measurement behind them."""

    q: Float[np.ndarray, " j"]
    covariance: Float[np.ndarray, "j j"]
    unseen: Bool[np.ndarray, " k"]
    status: str
    confidence: float
    measured: Measured


def track_surface(
    frames: Iterable[Image | Sequence[Image]],
    surface: Surface,
    camera: Camera | Sequence[Camera],
    start_pose: Float[np.ndarray, " j"],
    fps: float = 25.0,
    settings: Settings | None = None,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Track a skinned hand through images; parameters as for `handtrack.tracker.track`.

    Of the settings `passes`, `spacing`, `interpolation`, `filter`, `theta`, `start_sigma`, `start_speed` and `solver`
    matter.

    Raises
    ------
    ValueError
        For a start pose of the wrong length, images of another size than the camera's, or no image at all.
    """
    settings, model = settings or Settings(), surface.model
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera)
    on = tuple(chain(model, each) for each in cameras)
    if start_pose.shape != (len(model.joint_names),):
        wanted = f"{len(model.joint_names)} joints of model '{model.name}'"
        raise ValueError(f"start_pose: got {start_pose.size} values, wanted the {wanted}")
    state, done, moments, seconds = begin(start_pose[model.free], fps, settings), [], [], []
    for number, given in enumerate(frames):
        images = (given,) if isinstance(given, np.ndarray) else tuple(given)
        now = float(times[number]) if times is not None else number / fps
        begun = time.perf_counter()
        state, frame = step(state, images, surface, on, now - moments[-1] if moments else 0.0, settings)
        seconds.append(time.perf_counter() - begun)
        done.append(_kept(frame, model.link_frame.size))
        moments.append(now)
        if progress is not None:
            progress(number + 1)
    if not done:
        raise ValueError("frames: there is no image to track")
    columns = [np.stack(column) for column in zip(*done, strict=True)]
    q, covariance, information, status, confidence, residual, visible, edges = columns
    return Track(
        joint_names=model.joint_names,
        frame=np.arange(len(done)),
        time=np.array(moments),
        q=q,
        sigma=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
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
    )


def begin(u: Float[np.ndarray, " k"], fps: float, settings: Settings) -> State:
    """State before the first frame."""
    shape = np.zeros((u.size, u.size))
    return State(first_prediction(u, fps, settings), None, first_scatter(), first_shape_error(), shape, 1.0, 1.0, 0)


def step(
    state: State, images: Sequence[Image], surface: Surface, on: Sequence[Chain], dt: float, settings: Settings
) -> tuple[State, SurfaceFrame]:
    """One moment in all views."""
    _check(images, on)
    ahead = predict(state.prediction, dt)
    prior = prior_of(on[0], ahead.motion)
    passes = settings.passes + (_START_PASSES if state.frames < _START_FRAMES else 0)
    appearance = state.appearance or _learnt(images, surface, on, prior.mean, (None,) * len(on))
    found = measure(images, surface, on, appearance, state, prior, prior.mean, passes, settings)
    if state.appearance is None:  # the first was learnt at a pose that is only supposed, as if the image were sharp
        sharp = _learnt(images, surface, on, found.u, (None,) * len(on))
        through = _through_lens(images, surface, on, found.u, sharp)
        again = [its if lens_blur(its) == 0.0 else forgotten(its) for its in through]
        appearance = _learnt(images, surface, on, found.u, again)
        found = measure(images, surface, on, appearance, state, prior, found.u, passes, settings)
    if _share(found) < _LOST_BELOW:  # what was found is not the hand
        found = _unseen(found.seen, prior, min(2.0 * found.widen, _WIDEST))
    else:
        found = _aligned(images, surface, on, appearance, prior, found, state.conflict)
    scatter, shape, shaped = state.scatter, state.shape, state.shape_covariance
    if found.edges is not None:
        scatter, shape, shaped = _assessed(state, surface, on, prior, found)
        if state.frames < _YOUNG or state.frames % _EVERY == 0:
            appearance = _learnt(images, surface, on, found.u, appearance)
        if state.frames < _START_FRAMES or state.frames % _LENS_EVERY == 0:
            appearance = _through_lens(images, surface, on, found.u, appearance)
    following = correct(ahead, found.u, found.information, prior.mean, prior.information)
    frame = _frame(surface, found, shaped, following)
    widen = max(1.0, 0.8 * found.widen)
    conflict = _mixed(state.conflict, found.conflict)
    return State(following, appearance, scatter, shape, shaped, conflict, widen, state.frames + 1), frame


def _check(images: Sequence[Image], on: Sequence[Chain]) -> None:
    if len(images) != len(on):
        raise ValueError(f"image: got {len(images)} images for {len(on)} cameras; one for each is wanted")
    for image, view in zip(images, on, strict=True):
        if image.shape != (view.camera.height, view.camera.width):
            wanted = f"{view.camera.width} x {view.camera.height}"
            raise ValueError(f"image: got {image.shape[1]} x {image.shape[0]} pixels, the camera has {wanted}")


def _learnt(
    images: Sequence[Image],
    surface: Surface,
    on: Sequence[Chain],
    u: Float[np.ndarray, " k"],
    before: Sequence[SurfaceAppearance | None],
) -> tuple[SurfaceAppearance, ...]:
    views = zip(images, on, before, strict=True)
    return tuple(learn_surface(image, surface, view.camera, u, its) for image, view, its in views)


def _through_lens(
    images: Sequence[Image],
    surface: Surface,
    on: Sequence[Chain],
    u: Float[np.ndarray, " k"],
    appearance: Sequence[SurfaceAppearance],
) -> tuple[SurfaceAppearance, ...]:
    views = zip(images, on, appearance, strict=True)
    return tuple(learn_lens(image, surface, view.camera, u, its) for image, view, its in views)


def measure(
    images: Sequence[Image],
    surface: Surface,
    on: Sequence[Chain],
    appearance: Sequence[SurfaceAppearance],
    state: State,
    prior: Prior,
    u: Float[np.ndarray, " k"],
    passes: int,
    settings: Settings,
) -> Measured:
    """Look and fit in turn until the edges rest."""
    root = np.linalg.cholesky(prior.information).T
    search, widen, done, seen = prior.covariance, state.widen, None, ()
    for number in range(passes):
        views = list(zip(images, on, appearance, strict=True))
        seen = tuple(
            surface_look(image, surface, view.camera, u, search, its, settings, widen) for image, view, its in views
        )
        rows = _stacked(surface, on, seen)
        if rows.sigma.size < _LEAST_ROWS:
            search, widen = search * 4.0, min(2.0 * widen, _WIDEST)
            continue
        white = whitener(rows.sigma, rows.group, state.scatter)
        found = fit(on[0], None, rows, white, u, prior.mean, root, settings, number == 0)
        covariance = np.linalg.inv(found.information + prior.information)
        moved = float(np.abs(found.J @ (found.u - u) * rows.sigma).max()) * state.scatter.s
        u, search = found.u, 2.0 * covariance
        done = Measured(u, found.information, covariance, seen, found, rows, white, widen)
        if number and moved < _REST:
            break
    return done or _unseen(seen, prior, widen)


def _unseen(seen: tuple[SurfaceLook, ...], prior: Prior, widen: float) -> Measured:
    """A frame that tells nothing: the prediction, to be searched for farther out the next time."""
    return Measured(prior.mean, np.zeros_like(prior.covariance), prior.covariance, seen, None, None, None, widen)


def _stacked(surface: Surface, on: Sequence[Chain], seen: Sequence[SurfaceLook]) -> Rows:
    views = zip(on, seen, strict=True)
    return stack_rows(
        [surface_rows(surface, view.camera, look.features, look.samplers.side[look.found]) for view, look in views]
    )


def _share(found: Measured) -> float:
    """Share of the expected edges that was found."""
    expected = sum(int(look.expected.sum()) for look in found.seen)
    return sum(int(look.found.sum()) for look in found.seen) / expected if expected else 0.0


def _aligned(
    images: Sequence[Image],
    surface: Surface,
    on: Sequence[Chain],
    appearance: Sequence[SurfaceAppearance],
    prior: Prior,
    found: Measured,
    conflict: float,
) -> Measured:
    """The pose that aligns all pixels, if the edges do not speak against it."""
    cameras = [view.camera for view in on]
    to = align(images, surface, cameras, appearance, found.u, prior.mean, prior.information, found.covariance)
    if to.fitting < _LOST_BELOW:
        return _unseen(found.seen, prior, min(2.0 * found.widen, _WIDEST))
    off = to.u - found.u
    if not to.information.any() or off @ np.linalg.solve(found.covariance, off) > _FAR**2 * off.size:
        return replace(found, fitting=to.fitting)
    information = to.information / max(1.0, _mixed(conflict, to.conflict))
    covariance = np.linalg.inv(information + prior.information)
    return replace(
        found, u=to.u, information=information, covariance=covariance, conflict=to.conflict, fitting=to.fitting
    )


def _mixed(before: float, now: float | None) -> float:
    """Conflict between outlines and shading, averaged over frames."""
    return before if now is None else _MEMORY * before + (1.0 - _MEMORY) * now


def _assessed(
    state: State, surface: Surface, on: Sequence[Chain], prior: Prior, found: Measured
) -> tuple[Scatter, ShapeError, Float[np.ndarray, "k k"]]:
    """Scatter of the edges and error of the shape with this frame learnt, as `handtrack.consistency` does."""
    edges, rows, white, k = found.edges, found.rows, found.white, found.u.size
    if edges is None or rows is None or white is None:
        return state.scatter, state.shape, state.shape_covariance
    r, J = rows.residual(found.u)
    views = zip(on, found.seen, strict=True)
    H = np.concatenate([surface_shape_jacobian(surface, view.camera, look.features, found.u) for view, look in views])
    # K maps errors of the edges, in units of sigma, to those of the pose that the edges alone give.
    alone = np.linalg.inv(edges.information + prior.information)
    K = alone @ white(edges.r, edges.J * edges.weight[:, None] / edges.spread**2)[1].T
    least = replace(state.scatter, s=min(state.scatter.s, _PLAIN_S), tau=min(state.scatter.tau, _PLAIN_TAU))
    root = np.sqrt(edges.weight)
    plain, both = whitener(rows.sigma, rows.group, least)(r, np.hstack([J, H]))
    plain, both = root * plain, root[:, None] * both
    within = np.linalg.inv(both[:, :k].T @ both[:, :k] + prior.information)
    shape, suggested = learn_shape_error(state.shape, plain, both[:, k:], both[:, :k], within)
    z = np.abs(edges.r / edges.spread)
    scatter = learn_scatter(state.scatter, r - H @ suggested, J, z, rows.sigma, rows.group, K)
    shaped = shape.eps * (K @ H)
    return scatter, shape, shaped @ shaped.T


def _frame(surface: Surface, found: Measured, shaped: Float[np.ndarray, "k k"], following: Prediction) -> SurfaceFrame:
    model = surface.model
    C, share = model.coupling, min(_share(found), found.fitting) if found.information.any() else 0.0
    known = UNCERTAIN if share < _UNCERTAIN_BELOW or following.unseen.any() else TRACKED
    status = LOST if share < _LOST_BELOW else known
    confidence = share * (1.0 - 0.5 * float(following.unseen.mean()))
    q = C @ found.u + model.coupling_offset
    return SurfaceFrame(q, C @ (found.covariance + shaped) @ C.T, following.unseen, status, confidence, found)


def _kept(frame: SurfaceFrame, links: int) -> tuple[np.ndarray | str | float | int, ...]:
    """What the track keeps of a frame."""
    found = frame.measured
    residual = 0.0
    if found.rows is not None and found.rows.sigma.size:
        residual = float(np.sqrt(np.mean((found.rows.residual(found.u)[0] * found.rows.sigma) ** 2)))
    visible = np.array([visible_share(look.samplers, look.edges, links) for look in found.seen])
    edges = np.array([int(look.found.sum()) for look in found.seen])
    return frame.q, frame.covariance, found.information, frame.status, frame.confidence, residual, visible, edges
