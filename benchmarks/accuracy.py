"""Accuracy over seeded motions: `python benchmarks/accuracy.py [--scene NAME ...] [--motions 20] [--refine] ...`.

For each scene and group of joints (a hand's thumb is told apart from its fingers): median and largest over the motions
of the worst joint's RMSE, the mean NEES a degree of freedom, the share of errors within two sigmas, the share of frames
tracked, the median computing time of a frame (several workers slow each other down), and the median over motions of
the worst joint's RMSE as a ratio to its Cramer-Rao bound. `--wrong-radius` and `--wrong-length` give the tracker a
model that is off by so many per cent, `--calibrate` lets it find the shape from so many first frames.

Linear algebra libraries read their thread counts when they are loaded, hence the environment before the imports.
"""

import os
import sys

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"
sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context

import numpy as np

from handtrack.bound import bounds, spread_frames, usual_sigma
from handtrack.calibrate import calibrate
from handtrack.cli.console import note, say, say_json, table
from handtrack.evaluate import evaluate, joint_error, nees, prismatic_joints
from handtrack.kinematics import Model
from handtrack.residuals import chain
from handtrack.sequences import Truth
from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scene import Scene, images_together
from synth.scenes import full_hand_spread, two_finger_crossing, two_finger_hard
from synth.views import with_views

SCENES = {
    "two-finger-crossing": two_finger_crossing,
    "two-finger-hard": two_finger_hard,
    "full-hand-spread": full_hand_spread,
}
HEADER = ["scene", "joints", "worst rmse", "largest", "NEES/dof", "in 2 s %", "tracked %", "ms", "ratio"]


@dataclass(frozen=True, slots=True)
class Job:
    """One motion and how to track it; percentages by which the tracker's model is too large."""

    scene: str
    seed: int
    frames: int
    views: int
    wrong_radius: float
    wrong_length: float
    calibrate: int
    bound_frames: int
    settings: Settings


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one motion gave for one group of joints; degrees."""

    scene: str
    joints: str
    seed: int
    worst_joint: str
    worst_rmse: float
    nees_per_dof: float
    inside_2_sigma: float
    tracked: float
    frame_ms: float
    ratio: float | None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for, and print a table or JSON."""
    options = parse(arguments)
    chosen = json.loads(options.set) | {"refine": options.refine}
    settings = Settings(**chosen)
    jobs = [
        Job(
            scene,
            seed,
            options.frames,
            options.views,
            options.wrong_radius,
            options.wrong_length,
            options.calibrate,
            options.bound_frames,
            settings,
        )
        for scene in options.scene
        for seed in range(options.first_seed, options.first_seed + options.motions)
    ]
    outcomes = []
    for number, done in enumerate(run_all(jobs, options.workers), start=1):
        outcomes += done
        note(f"{number}/{len(jobs)} {done[0].scene} {done[0].seed}: " + ", ".join(brief(one) for one in done))
    rows = [summary(group) for group in grouped(outcomes)]
    if options.json:
        say_json({"settings": asdict(settings), "summary": rows, "motions": [asdict(one) for one in outcomes]})
    else:
        say(table(HEADER, [cells(row) for row in rows]))
    return 0


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--scene", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--motions", type=int, default=20, help="seeded motions of each scene (20)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--views", type=int, default=1, help="number of cameras, 1 to 5")
    parser.add_argument("--refine", action="store_true")
    parser.add_argument("--set", default="{}", help='more settings as JSON, e.g. \'{"edges": "width"}\'')
    parser.add_argument("--wrong-radius", type=float, default=0.0, metavar="PERCENT")
    parser.add_argument("--wrong-length", type=float, default=0.0, metavar="PERCENT")
    parser.add_argument("--calibrate", type=int, default=0, metavar="FRAMES", help="calibrate on so many frames first")
    parser.add_argument("--bound-frames", type=int, default=6, help="frames of a motion with a bound (6); 0 for none")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--json", action="store_true")
    return parser.parse_args(arguments)


def run_all(jobs: Sequence[Job], workers: int) -> Iterator[list[Outcome]]:
    """Outcomes of all jobs, in their order."""
    if workers <= 1:
        yield from map(run_one, jobs)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run_one, jobs)


def run_one(job: Job) -> list[Outcome]:
    """Render, track and evaluate one motion."""
    scene = with_views(SCENES[job.scene](job.seed, frames=job.frames), job.views)
    pictures = [tuple(np.asarray(image, dtype=np.float32) for image in views) for views in images_together(scene)]
    wrong = wrong_model(scene.model, job.wrong_radius / 100.0, job.wrong_length / 100.0)
    if job.calibrate:
        first = pictures[: job.calibrate]
        wrong = calibrate(first, wrong, scene.cameras, scene.start, scene.fps, job.settings).model
    found = track(pictures, wrong, scene.cameras, scene.start, scene.fps, job.settings)
    truth = Truth(np.arange(job.frames), scene.truth)
    result = evaluate(found, truth, scene.model, scene.camera)
    least = least_sigmas(scene, pictures, job.bound_frames) if job.bound_frames else None
    error = joint_error(found.q, scene.truth, prismatic_joints(scene.model))
    outcomes = []
    for name, chosen in joint_groups(scene.model).items():
        value, dof = nees(error[:, chosen], found.covariance[:, chosen][:, :, chosen])
        worst = chosen[int(np.argmax(result.rmse[chosen]))]
        outcomes.append(
            Outcome(
                scene=job.scene,
                joints=name,
                seed=job.seed,
                worst_joint=scene.model.joint_names[worst],
                worst_rmse=float(np.degrees(result.rmse[worst])),
                nees_per_dof=float(value.sum() / max(dof.sum(), 1)),
                inside_2_sigma=float(np.mean(np.abs(error[:, chosen]) <= 2.0 * found.sigma[:, chosen])),
                tracked=result.share_tracked,
                frame_ms=float(1000.0 * np.median(found.seconds)),
                ratio=None if least is None or np.isinf(least[worst]) else float(result.rmse[worst] / least[worst]),
            )
        )
    return outcomes


def least_sigmas(scene: Scene, pictures: Sequence[tuple[np.ndarray, ...]], most: int) -> np.ndarray:
    """Median bound of every joint over some frames, radians."""
    number = spread_frames(len(pictures), most)
    on = [chain(scene.model, camera) for camera in scene.cameras]
    return usual_sigma(bounds((pictures[i] for i in number), on, scene.truth[number], number))


def wrong_model(model: Model, radius: float, length: float) -> Model:
    """The model with all radii and all distances along its links larger by these shares."""
    prefix = model.prefix.copy()
    on_link = np.isin(model.parent, model.link_frame)
    prefix[on_link, 0, 3] *= 1.0 + length
    along = np.array([1.0 + length, 1.0, 1.0])
    return replace(
        model,
        prefix=prefix,
        link_radius=model.link_radius * (1.0 + radius),
        link_length=model.link_length * (1.0 + length),
        link_base=model.link_base * along,
        link_tip=model.link_tip * along,
    )


def joint_groups(model: Model) -> dict[str, np.ndarray]:
    """Joints that are judged together: all, or fingers and thumb apart where there are both."""
    thumb = np.array([name.startswith("thumb") for name in model.joint_names])
    if thumb.all() or not thumb.any():
        return {"all": np.arange(thumb.size)}
    return {"fingers": np.flatnonzero(~thumb), "thumb": np.flatnonzero(thumb)}


def grouped(outcomes: Sequence[Outcome]) -> Iterator[list[Outcome]]:
    """Outcomes of one scene and group of joints after the other."""
    for key in dict.fromkeys((one.scene, one.joints) for one in outcomes):
        yield [one for one in outcomes if (one.scene, one.joints) == key]


def summary(group: Sequence[Outcome]) -> dict[str, object]:
    """Over the motions of a scene: one row of the table."""
    worst = np.array([one.worst_rmse for one in group])
    ratios = [one.ratio for one in group if one.ratio is not None]
    return {
        "scene": group[0].scene,
        "joints": group[0].joints,
        "worst_rmse_median_deg": round(float(np.median(worst)), 4),
        "worst_rmse_largest_deg": round(float(worst.max()), 4),
        "nees_per_dof": round(float(np.mean([one.nees_per_dof for one in group])), 3),
        "inside_2_sigma_percent": round(100.0 * float(np.mean([one.inside_2_sigma for one in group])), 1),
        "tracked_percent": round(100.0 * float(np.mean([one.tracked for one in group])), 1),
        "frame_ms": round(float(np.median([one.frame_ms for one in group])), 2),
        "worst_rmse_to_bound": round(float(np.median(ratios)), 1) if ratios else None,
    }


def cells(row: dict[str, object]) -> list[str]:
    """A row of the table as text: errors with three decimals."""
    return [f"{value:.3f}" if "rmse" in key and "deg" in key else str(value) for key, value in row.items()]


def brief(one: Outcome) -> str:
    """A motion in a few words."""
    return f"{one.joints} {one.worst_rmse:.3f} ({one.worst_joint})"


if __name__ == "__main__":
    sys.exit(main())
