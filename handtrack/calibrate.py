"""Images of a moving hand and a rough model in, a model of that very hand with sigmas out.

The shape of each link has seven parameters: its length, the radii of its two ends, and the sideways offsets (y and z of
its frame) of the two ends. They are the same in every frame while the pose is not, so both can be found: with r_f the
outline residuals of frame f, J_f their derivative by its pose and H_f by the shape, the poses are eliminated,

    S = P + sum_f H_f^T H_f - H_f^T J_f (J_f^T J_f + L_f)^-1 J_f^T H_f,

and the shape solves `S dp = -g`. Tracking with the better model finds better edges and more of them, so tracking and
solving alternate, over more frames each time. The inverse of S is the shape's covariance; the model keeps all of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .calibrate_buried import buried_shares
from .camera import Camera
from .kinematics import Model
from .link_shape import PARAMETERS, factor_of, reshaped, shape_rows, sigmas_from_covariance
from .residuals import Chain, OutlineFeatures, chain, outline_residuals, stack_features
from .robust import cauchy_weight, median
from .settings import Settings
from .tracker import Image, follow

_LENGTH, _RADIUS, _OFFSET = 0.05, 0.15, 0.12  # prior sigmas: of the length; of the radius; of the radius
_KIND = np.array([0, 1, 1, 2, 2, 2, 2])  # length, radius, offset
_NARROWEST = 0.02
_LEARNING, _FEW = 4, 0.3  # rounds of learning the prior in each solve; and weight of the narrowest, in parameters
_ROUNDS = ((4, 3), (8, 3), (16, 3), (32, 3), (64, 3))  # frames, and solves, of each round
_BURIED_AFTER = 1  # round: the shape is right but for what pills cannot be
_POSE_SIGMA = np.radians(12.0)  # how far a pose may move in one round
_CORRELATED = 4.0  # edges that share one error: neighbours on a side see the same unmodelled bulge


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated model.

    Attributes
    ----------
    model : Model
        With the shape found.
    shape, covariance : (l, 7), (7l, 7l)
        Change of length, two radii, and y, z offsets of base and tip, model units; and the covariance of all of them.
    residual_before, residual_after : float
        Root mean square distance of the edges from the outline, pixels.
    frames : (f,)
        Frames used.
    poses : (f, k)
        Independent joints in them.
    """

    model: Model
    shape: Float[np.ndarray, "l 7"]
    covariance: Float[np.ndarray, "n n"]
    residual_before: float
    residual_after: float
    frames: Int[np.ndarray, " f"]
    poses: Float[np.ndarray, "f k"]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The edges of one moment in all views, and the pose u they were seen from with its prior."""

    features: OutlineFeatures
    frame: int
    u: Float[np.ndarray, " k"]
    mean: Float[np.ndarray, " k"]
    prior: Float[np.ndarray, "k k"]


def calibrate(
    images: Sequence[Image | Sequence[Image]],
    model: Model,
    cameras: Sequence[Camera],
    start_pose: Float[np.ndarray, " j"],
    fps: float = 25.0,
    settings: Settings | None = None,
    progress: Callable[[int], None] | None = None,
) -> Calibration:
    """Fit the shape of every link to the first frames of a sequence.

    Parameters
    ----------
    images : sequence
        The more different the poses, the better; 64 are used at the most.
    start_pose : (j,)
        Joint values in the first frame; its standard deviation is `settings.start_sigma`.

    Raises
    ------
    ValueError
        If no image shows the model.
    """
    # With a wrong shape the other side of a fold may look the better one: a track that changes sides fits no shape.
    settings = replace(settings or Settings(), residuals="outline", edges="wssd", refine=False, hypotheses=False)
    widest = _prior(model)
    prior, sights = widest, []
    shape = np.zeros((model.link_frame.size, PARAMETERS))
    first_rms, rms, S = None, 0.0, np.diag(1.0 / prior**2)
    used = 0
    for number, (count, solves) in enumerate(_ROUNDS):
        chosen = images[:count]
        if used == len(chosen) and number:
            break
        used = len(chosen)
        sights = _sights(chosen, reshaped(model, shape), cameras, start_pose, fps, settings)
        for _ in range(solves if sights else 0):
            shape, sights, S, rms, prior = _solve(model, cameras[0], shape, sights, prior, widest)
            first_rms = rms if first_rms is None else first_rms
        if sights and number == _BURIED_AFTER and model.link_buried is None:
            near = [(sight.features, sight.u) for sight in sights]
            buried = buried_shares(chain(reshaped(model, shape), cameras[0]), near)
            if buried is not None:  # false edges have bent the shape by now
                bare = replace(model, link_buried=buried)
                return calibrate(images, bare, cameras, start_pose, fps, settings, progress)
        if progress is not None:
            progress(number + 1)
    if not sights:
        raise ValueError("images: no frame shows enough edges of the model to calibrate its shape")
    done = Calibration(
        model=model,
        shape=shape,
        covariance=np.linalg.inv(S),
        residual_before=first_rms or 0.0,
        residual_after=rms,
        frames=np.array([sight.frame for sight in sights]),
        poses=np.stack([sight.u for sight in sights]),
    )
    factor = factor_of(done.covariance)
    known = {"link_sigmas": sigmas_from_covariance(factor @ factor.T), "shape_factor": factor}
    return replace(done, model=replace(reshaped(model, shape), **known))


def _prior(model: Model) -> Float[np.ndarray, " p"]:
    radius = model.link_radius.mean(axis=1)
    columns = [_LENGTH * model.link_length, *([_RADIUS * radius] * 2), *([_OFFSET * radius] * 4)]
    return np.stack(columns, axis=1).ravel()


def _learnt_prior(
    widest: Float[np.ndarray, " p"],
    prior: Float[np.ndarray, " p"],
    told: Float[np.ndarray, "p p"],
    towards: Float[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    """Prior sigmas that fit what is found: lengths, radii and offsets are each as wrong as these of this model are.

    The images say `told @ shape = towards`. The variance of each kind is the square sum of what is found over the
    number of parameters that images, and not the prior, determine (MacKay, Neural Computation 4, 1992, eq. (2.22)), so
    a hand whose lengths are right keeps them also where only its radii were wrong.
    """
    kind = np.tile(_KIND, widest.size // PARAMETERS)
    for _ in range(_LEARNING):
        covariance = np.linalg.inv(told + np.diag(1.0 / prior**2))
        found = covariance @ towards
        determined = np.maximum(1.0 - np.diag(covariance) / prior**2, 0.0)
        square = (np.bincount(kind, (found / widest) ** 2) + _FEW * _NARROWEST**2) / (
            np.bincount(kind, determined) + _FEW
        )
        prior = widest * np.clip(np.sqrt(square), _NARROWEST, 1.0)[kind]
    return prior


def _sights(
    images: Sequence[Image | Sequence[Image]],
    model: Model,
    cameras: Sequence[Camera],
    start_pose: Float[np.ndarray, " j"],
    fps: float,
    settings: Settings,
) -> list[Sight]:
    """Track the images and keep the edges of each."""
    on = [chain(model, camera) for camera in cameras]
    found = []
    weak = np.eye(model.free.size) / _POSE_SIGMA**2
    for number, (_, _, frame) in enumerate(follow(images, on, start_pose, fps, settings)):
        features = stack_features([view.features for view in frame.estimate.seen])
        if not isinstance(features, OutlineFeatures) or features.link.size < 3:
            continue
        u = frame.estimate.u
        mean = start_pose[model.free] if number == 0 else u
        known = np.eye(u.size) / settings.start_sigma**2 if number == 0 else weak
        found.append(Sight(features, number, u, mean, known))
    return found


def _solve(
    model: Model,
    camera: Camera,
    shape: Float[np.ndarray, "l 7"],
    sights: list[Sight],
    prior: Float[np.ndarray, " p"],
    widest: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "l 7"], list[Sight], Float[np.ndarray, "p p"], float, Float[np.ndarray, " p"]]:
    """One Gauss-Newton step of shape and poses: shape, poses, the shape's information, RMS in pixels, its prior."""
    on = chain(reshaped(model, shape), camera)
    S, g = np.zeros((prior.size, prior.size)), np.zeros(prior.size)
    parts, squares, edges = [], 0.0, 0
    for sight in sights:
        r, J, H = _rows(on, sight)
        squares, edges = squares + float(((r * sight.features.sigma) ** 2).sum()), edges + r.size
        weight = cauchy_weight(r / max(1.0, 1.4826 * median(np.abs(r))))
        weight = weight / max(1.0, 1.4826 * median(np.abs(r))) ** 2 / _CORRELATED
        Jw, Hw = J * weight[:, None], H * weight[:, None]
        A = Jw.T @ J + sight.prior
        of_u = Jw.T @ r + sight.prior @ (sight.u - sight.mean)
        B = Jw.T @ H
        S += Hw.T @ H - B.T @ np.linalg.solve(A, B)
        g += Hw.T @ r - B.T @ np.linalg.solve(A, of_u)
        parts.append((A, B, of_u))
    prior = _learnt_prior(widest, prior, S, S @ shape.ravel() - g)
    S, g = S + np.diag(1.0 / prior**2), g + shape.ravel() / prior**2
    step = -np.linalg.solve(S, g)
    limits = model.limits[model.free]
    moved = []
    for sight, (A, B, of_u) in zip(sights, parts, strict=True):
        u = sight.u - np.linalg.solve(A, of_u + B @ step)
        moved.append(replace(sight, u=np.clip(u, limits[:, 0], limits[:, 1])))
    return shape + step.reshape(shape.shape), moved, S, float(np.sqrt(squares / max(edges, 1))), prior


def _rows(
    on: Chain, sight: Sight
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"], Float[np.ndarray, "n p"]]:
    r, J = outline_residuals(on, sight.features, sight.u)
    return r, J, shape_rows(on.model, sight.features, sight.u)
