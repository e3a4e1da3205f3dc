"""Real keypoints of four views in; each view followed on its own, and how it agrees with the triangulation, out.

Depths are the reference's, since the recording has none; confidences, jitter and holes are the network's own.

python benchmarks/real_people.py TRIAL CALIBRATION.toml    # pose/, pose-3d/ as Pose2Sim's demonstration has
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from handtrack.body.people import Settings, follow
from handtrack.body.people_baselines import baseline
from handtrack.body.people_metrics import QUANTILE_95, accuracy, squares
from handtrack.body.triangulated import agreement, lifted, reference_of
from handtrack.camera import camera_from_world
from handtrack.formats.calibrations import read_calibration
from handtrack.formats.markers import read_markers
from handtrack.formats.openpose import read_openpose
from handtrack.formats.people import LOST, People


def courses(people: People, frames: int, name: str):
    """One keypoint array of the label that is there longest, in every frame; NaN where it is not."""
    labels, counts = np.unique(people.person, return_counts=True)
    own = people.person == labels[counts.argmax()]
    values = getattr(people, name)[own]
    out = np.full((frames, *values.shape[1:]), np.nan)
    out[people.frame[own]] = values
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trial", type=Path)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--fps", type=float, default=60.0)
    chosen = parser.parse_args()
    _, cameras = read_calibration(chosen.calibration)
    reference = reference_of(read_markers(next((chosen.trial / "pose-3d").glob("*.trc"))))
    for folder, eye in zip(sorted((chosen.trial / "pose").iterdir()), cameras, strict=True):
        seen = lifted(read_openpose(folder, chosen.fps, (eye.width, eye.height)), reference, eye)
        wanted = Settings(distance=20.0, skin=0.0)
        people = follow(seen, wanted)
        frames = min(seen.time.size, reference.shape[0])
        truth = camera_from_world(eye, reference)[:frames]
        p = courses(people, seen.time.size, "p")[:frames]
        raw = courses(baseline("raw", seen, people, wanted), seen.time.size, "p")[:frames]
        covariance = courses(people, seen.time.size, "covariance")[:frames]
        known = courses(replace(people, status=people.status.astype(float)), seen.time.size, "status")[:frames] != LOST
        square = squares(p[:, :12], covariance[:, :12], truth[:, :12])
        rough = [
            np.nanmean([accuracy(seen.time[:frames], q[:, k], truth[:, k]).acc for k in range(12)]) for q in (p, raw)
        ]
        facts = {
            "view": folder.name,
            "frames": frames,
            "labels": int(np.unique(people.person).size),
            "raw_median_mm": round(1e3 * agreement(raw, truth).median, 1),
            "median_mm": round(1e3 * agreement(p, truth).median, 1),
            "raw_95_mm": round(1e3 * agreement(raw, truth).worst, 1),
            "p95_mm": round(1e3 * agreement(p, truth).worst, 1),
            "acc": round(float(rough[0]), 2),
            "raw_acc": round(float(rough[1]), 2),
            "inside_95": round(float((square[np.isfinite(square)] <= QUANTILE_95).mean()), 3),
            "not_lost": round(float(known[:, :12].mean()), 3),
        }
        sys.stdout.write(json.dumps(facts) + "\n")


if __name__ == "__main__":
    main()
