"""Images and the true poses in, the Cramer-Rao bound of every joint and frame out.

No unbiased estimate of a pose u from an image I(u) + noise, the noise independent and normal with standard deviation
sigma, has a smaller variance than the inverse of Fisher's information,

    F = sum over pixels and views of (dI/du)^T (dI/du) / sigma^2,        var(q_j) >= (C F^-1 C^T)_jj,

with q = C u + c all joints (Kay, Fundamentals of Statistical Signal Processing, volume 1, 1993, chapter 3). I(u) is
the posed pills' smooth image (`soft_image`), so dI/du holds moving outlines, creases and changing shades; it is taken
by the twists of the links and brought to the joints by `G = d twist / du`. Shape, camera, light and noise count as
known. Light, gains and background b may be left unknown instead: they are eliminated by the Schur complement,

    F = G^T (H_uu - H_ub H_bb^+ H_bu) G / sigma^2.

The bound is for one frame by itself. A filter that also uses earlier frames knows more, so may be better than it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .appearance import Appearance, learn
from .kinematics import Model, forward
from .measure import look
from .pills import pose_pills
from .residuals import Chain
from .settings import Settings
from .sharpness import learn_blur
from .soft_image import SoftImage, ray_grid, soft_image
from .synthesis import link_twists

Image = Float[np.ndarray, "h w"]

_NULL = 1e-9  # eigenvalues of the scaled information below this are no information
_TOUCHED = 1e-4  # component of a null direction from which a joint takes part in it
_MOST_ANGLE, _MOST_LENGTH = np.pi, 1e3  # a bound above this tells nothing of a joint
_NEAR = np.radians(0.5)  # how far from the truth the blur's edges are searched


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """The least standard deviation of every joint in some frames, from the images of that frame alone.

    Attributes
    ----------
    frame : (n,)
        Frame numbers.
    sigma : (n, j)
        Radians (model units for prismatic joints); inf where the images say nothing of a joint.
    noise : (n, v)
        Standard deviation of the noise in each view, grey levels.
    known_light : bool
        Whether light, gains and background count as known.
    """

    frame: Int[np.ndarray, " n"]
    sigma: Float[np.ndarray, "n j"]
    noise: Float[np.ndarray, "n v"]
    known_light: bool


def spread_frames(count: int, most: int) -> Int[np.ndarray, " n"]:
    """Numbers of at most `most` of `count` frames, evenly spread from the first to the last.

    >>> spread_frames(5, 9).tolist(), spread_frames(100, 3).tolist()
    ([0, 1, 2, 3, 4], [0, 50, 99])
    """
    if most < 1:
        raise ValueError(f"most: got {most}, wanted at least 1")
    return np.unique(np.rint(np.linspace(0, count - 1, min(most, count))).astype(int))


def bounds(
    images: Iterable[Sequence[Image]],
    on: Sequence[Chain],
    q: Float[np.ndarray, "n j"],
    frame: Int[np.ndarray, " n"],
    known_light: bool = True,
    progress: Callable[[int], None] | None = None,
) -> Bounds:
    """Bound of every joint in frames whose pose is known; appearance, blur and noise are learnt from their images.

    Parameters
    ----------
    images : iterable of tuples of (h, w)
        Of these frames, one for each view.
    on : sequence of Chain
        The views.
    q, frame : (n, j), (n,)
        True joint values, all finite, and frame numbers.
    progress : callable
        Called with the number of frames done.

    Raises
    ------
    ValueError
        For a pose with missing values, or fewer images than poses.
    """
    if not np.isfinite(q).all():
        raise ValueError("q: holds NaN; a whole pose was wanted for every frame")
    grids = [ray_grid(view.camera) for view in on]
    known: list[Appearance | None] = [None] * len(on)
    sigma, noise = np.empty(q.shape), np.empty((q.shape[0], len(on)))
    row = -1
    for row, (together, pose) in enumerate(zip(images, q, strict=False)):
        F = np.zeros((on[0].model.free.size,) * 2)
        for i, (image, view, grid) in enumerate(zip(together, on, grids, strict=True)):
            its = learn_true(image, view, pose, known[i])
            F += image_information(view, pose, its, grid, known_light)
            known[i], noise[row, i] = its, its.noise
        sigma[row] = least_sigma(on[0].model, F)
        if progress is not None:
            progress(row + 1)
    if row + 1 < q.shape[0]:
        raise ValueError(f"images: got {row + 1}, wanted one for each of {q.shape[0]} poses")
    return Bounds(frame, sigma, noise, known_light)


def learn_true(image: Image, on: Chain, q: Float[np.ndarray, " j"], previous: Appearance | None) -> Appearance:
    """Appearance at a pose known to be true, on top of what earlier frames told; the blur from the first frame."""
    pills = pose_pills(on.model, forward(on.model, q), on.camera)
    if previous is not None:
        return learn(image, pills, on.camera, previous)
    first, settings, u = learn(image, pills, on.camera), Settings(), q[on.model.free]
    seen = look(image, on, u, _NEAR**2 * np.eye(u.size), first, settings)
    return learn_blur(image, on, seen, first, settings)


def image_information(
    on: Chain,
    q: Float[np.ndarray, " j"],
    appearance: Appearance,
    grid: Float[np.ndarray, "h w 2"] | None = None,
    known_light: bool = True,
) -> Float[np.ndarray, "k k"]:
    """Fisher's information of one image on the independent joints, 1 / radian^2."""
    model = on.model
    frames = forward(model, q)
    soft = soft_image(pose_pills(model, frames, on.camera), on.camera, appearance, grid, light=not known_light)
    G = link_twists(on, frames) @ model.coupling
    F = G.T @ soft.motion @ G
    if not known_light:
        F = F - _told_of_light(soft, G)
    return (F + F.T) / (2.0 * appearance.noise**2)


def _told_of_light(soft: SoftImage, G: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "k k"]:
    """What an unknown light takes away: `H_ub H_bb^+ H_bu`; shading and gains share a factor, hence the inverse."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(soft.light), 1e-12))
    cross = (G.T @ soft.cross) * scale
    value, vector = np.linalg.eigh(soft.light * scale * scale[:, None])
    kept = value > _NULL
    along = (cross @ vector[:, kept]) / np.sqrt(value[kept])
    return along @ along.T


def least_sigma(model: Model, information: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " j"]:
    """Cramer-Rao bound of all joints from the information on the independent ones; inf for a joint that is unseen.

    A joint is unseen if it takes part in a direction of which there is no information. It does not take the others with
    it.

    >>> from .kinematics.builtin import model
    >>> least_sigma(model("rr"), np.diag([4.0, 0.0])).tolist()
    [0.5, inf]
    """
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    seen = size > 0.0
    scale = np.where(seen, 1.0 / np.where(seen, size, 1.0), 0.0)
    value, vector = np.linalg.eigh(information * scale * scale[:, None])
    kept = value > _NULL
    unseen = ~seen | (np.abs(vector[:, ~kept]) > _TOUCHED).any(axis=1)
    root = scale[:, None] * vector[:, kept] / np.sqrt(value[kept])
    sigma = np.linalg.norm(model.coupling @ root, axis=1)
    lost = (np.abs(model.coupling) @ unseen.astype(float) > 0.0) | (sigma > _limit(model))
    return np.where(lost, np.inf, sigma)


def _limit(model: Model) -> Float[np.ndarray, " j"]:
    """Above this a bound tells nothing."""
    slides = np.zeros(len(model.joint_names), dtype=bool)
    slides[model.joint[model.joint >= 0]] = model.prismatic[model.joint >= 0]
    return np.where(slides, _MOST_LENGTH, _MOST_ANGLE)


def usual_sigma(found: Bounds) -> Float[np.ndarray, " j"]:
    """Median over the frames of each joint's bound; inf for a joint that is unseen in half of them or more."""
    middle = found.sigma.shape[0] // 2
    return np.sort(found.sigma, axis=0)[middle] if found.sigma.shape[0] % 2 else _between(found.sigma, middle)


def _between(sigma: Float[np.ndarray, "n j"], middle: int) -> Float[np.ndarray, " j"]:
    """Mean of the two middle rows; numpy's median of two infinities would be NaN."""
    low, high = np.sort(sigma, axis=0)[[middle - 1, middle]]
    return np.where(np.isinf(high), np.inf, 0.5 * (low + np.where(np.isinf(high), 0.0, high)))
