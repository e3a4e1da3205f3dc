"""
Calibration: the shape of a hand from its first frames
======================================================

A model whose radii are wrong by a few per cent fits the images nearly as well: what the radii get wrong the pose makes
up for, where no residual shows it. The shape is the same in every frame while the pose is not, so the first frames
tell both. The model that comes out knows how well its shape is known, all links together.

Run ``python examples/08_calibration.py --out calibration.png`` to keep the picture.
"""

import argparse
from dataclasses import replace

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.calibrate import calibrate
from handtrack.tracker import track
from synth.scenes import images, two_finger_crossing

# %%
# Two fingers that cross, and a model of them whose radii are 5 % too large.

scene = two_finger_crossing(seed=3, frames=40)
pictures = list(images(scene))
wrong = replace(scene.model, link_radius=1.05 * scene.model.link_radius)
found = calibrate(pictures[:20], wrong, [scene.camera], scene.start, scene.fps)

# %%
# Track with both. The normalised squared error of the pose is 6 on average where its covariance is honest.

runs = [(name, track(pictures, model, scene.camera, scene.start, scene.fps))
        for name, model in (("5 % too wide", wrong), ("calibrated", found.model))]  # fmt: skip
for name, run in runs:
    error = run.q - scene.truth
    worst = np.degrees(np.sqrt((error**2).mean(axis=0)).max())
    squared = np.mean([e @ np.linalg.solve(C, e) for e, C in zip(error, run.covariance, strict=True)])
    print(f"{name}: worst joint {worst:.2f} degrees RMSE, normalised squared error {squared:.1f} of {error.shape[1]}")

# %%
# Left, the radius of each link with its sigma; right, the error of the joint that suffers most.

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
number, sigma = np.arange(12), [value for known in found.model.link_sigmas for value in known.radius]
left.axhline(0.0, color="black", linewidth=0.8)
left.plot(number, (wrong.link_radius - scene.model.link_radius).ravel(), "o", label="as it came")
left.errorbar(number, (found.model.link_radius - scene.model.link_radius).ravel(), 2.0 * np.array(sigma), fmt="s",
              label="calibrated, two sigmas")  # fmt: skip
left.set(title="radius at both ends of each link", xlabel="end", ylabel="error (mm)")
left.legend()
joint = int(np.argmax(np.abs(runs[0][1].q - scene.truth).mean(axis=0)))
for name, run in runs:
    right.plot(run.frame, np.degrees(run.q - scene.truth)[:, joint], label=name)
right.axhline(0.0, color="black", linewidth=0.8)
right.set(title=scene.model.joint_names[joint], xlabel="frame", ylabel="error (degrees)")
right.legend()

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Calibrates a model with wrong radii and tracks with it.")
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=110)
