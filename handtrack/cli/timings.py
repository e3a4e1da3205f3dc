"""A number of frames in, medians of computing times out: ours, and that of the plain way of doing the same.

Everything runs once before it is timed, so that nothing is compiled or cached while the clock runs; OpenCV and numba
are held to one thread.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np
from skimage.measure import profile_line

from synth.render import render, render_numpy
from synth.scenes import Scene, full_hand_spread, images, posed, two_finger_crossing

from ..kinematics import forward, forward_numpy
from ..kinematics.builtin import model as builtin_model
from ..profiles import place_outline, sample, sample_numpy
from ..settings import Settings
from ..tracker import track
from .plain_look import PlainRound


@dataclass(frozen=True, slots=True)
class Timing:
    """One line of the table: median milliseconds of ours and, where there is one, of its plain twin."""

    name: str
    ours_ms: float
    twin: str = ""
    twin_ms: float | None = None

    @property
    def ratio(self) -> float | None:
        """How many times faster ours is."""
        return None if self.twin_ms is None else self.twin_ms / self.ours_ms

    def as_data(self) -> dict[str, object]:
        """The line for machines."""
        return {
            "name": self.name,
            "ms": self.ours_ms,
            "against": self.twin,
            "against_ms": self.twin_ms,
            "ratio": self.ratio,
        }


def measure_all(frames: int = 60, repeats: int = 30) -> list[Timing]:
    """All timings, on one thread."""
    cv2.setNumThreads(1)
    scene = two_finger_crossing(0, frames=frames)
    pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
    return [
        *(tracking(scene, pictures, residuals) for residuals in ("outline", "lines")),
        *whole_hand(frames),
        rendering(scene, repeats),
        *profiles(scene, pictures[0], repeats),
        kinematics(repeats),
    ]


def tracking(scene: Scene, pictures: list[np.ndarray], residuals: str) -> Timing:
    """One frame of tracking; the images are in memory."""
    settings = Settings(residuals=residuals)  # type: ignore[arg-type]
    track(pictures[: min(len(pictures), 20)], scene.model, scene.camera, scene.start, scene.fps, settings)
    seconds = track(pictures, scene.model, scene.camera, scene.start, scene.fps, settings).seconds
    size = f"{scene.camera.width}x{scene.camera.height}"
    return Timing(f"track a frame, two fingers {size}, {residuals}", 1000.0 * float(np.median(seconds)))


def whole_hand(frames: int, repeats: int = 5) -> list[Timing]:
    """One frame of a hand of 21 joints, without and with refinement, beside one look and fit in plain NumPy."""
    scene = full_hand_spread(0, frames=frames)
    pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
    plain = median_ms(PlainRound(scene, pictures[0], Settings()), repeats)
    out = []
    for refined in (False, True):
        settings, few = Settings(refine=refined), pictures[: min(len(pictures), 10)]
        track(few, scene.model, scene.camera, scene.start, scene.fps, settings)
        seconds = track(pictures, scene.model, scene.camera, scene.start, scene.fps, settings).seconds
        name = f"track a frame, 21 joints, {'refined' if refined else 'not refined'}"
        out.append(Timing(name, 1000.0 * float(np.median(seconds)), "NumPy twins, one look and fit", plain))
    return out


def rendering(scene: Scene, repeats: int) -> Timing:
    """One shaded, anti-aliased image."""
    pills = posed(scene, 0)
    ours = median_ms(lambda: render(pills, scene.camera, scene.material, scene.light), repeats)
    plain = median_ms(lambda: render_numpy(pills, scene.camera, scene.material, scene.light), max(3, repeats // 6))
    return Timing("render an image, Phong, anti-aliased", ours, "NumPy twin", plain)


def profiles(scene: Scene, image: np.ndarray, repeats: int) -> list[Timing]:
    """Bilinear profiles across every outline sampler of a pose."""
    samplers = place_outline(posed(scene, 0), scene.camera, scene.model.link_is_tip)
    u = np.linspace(-30.0, 30.0, 61)
    ends = np.stack([samplers.origin + u[0] * samplers.direction, samplers.origin + u[-1] * samplers.direction], axis=1)
    ends = ends[..., ::-1]  # skimage: row, column

    def by_skimage() -> None:
        for start, stop in ends:
            profile_line(image, start, stop, order=1, mode="constant")

    name = f"sample {samplers.link.size} profiles of {u.size}"
    ours = median_ms(lambda: sample(image, samplers, u), repeats)
    return [
        Timing(name, ours, "NumPy twin", median_ms(lambda: sample_numpy(image, samplers, u), repeats)),
        Timing(name, ours, "skimage profile_line", median_ms(by_skimage, max(3, repeats // 6))),
    ]


def kinematics(repeats: int, batch: int = 1200) -> Timing:
    """Link frames of the whole hand, a batch of poses."""
    model = builtin_model("full_hand")
    low, high = np.maximum(model.limits, -1.0)[:, 0], np.minimum(model.limits, 1.0)[:, 1]
    q = np.random.default_rng(0).uniform(low, high, (batch, low.size))
    ours, plain = median_ms(lambda: forward(model, q), repeats), median_ms(lambda: forward_numpy(model, q), repeats)
    return Timing(f"forward kinematics, 21 joints, {batch} poses", ours, "NumPy twin", plain)


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call in milliseconds, after one that does not count."""
    work()
    times = []
    for _ in range(repeats):
        begun = perf_counter()
        work()
        times.append(perf_counter() - begun)
    return 1000.0 * float(np.median(times))
