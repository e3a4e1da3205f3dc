"""
Tracking: two fingers through an occlusion, with honest sigmas
==============================================================

The index finger crosses in front of the middle finger (section 6.1 of the hand thesis). The images come from the
renderer with exact truth; the tracker sees only images, model, camera and a start pose that is three degrees off in
every joint. It returns, for every frame, joint angles, their covariance and a status.

Run ``python examples/05_tracking.py --out tracking.png`` to keep the picture.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scenes import image, images, two_finger_crossing

# %%
# A short sequence: 40 frames, noise of 3 grey levels, the fastest joint moving 4 degrees a frame.

scene = two_finger_crossing(seed=3, frames=40, projection="perspective", noise=3.0, max_speed=4.0, start_error=3.0)

# %%
# Track it. ``images`` renders one frame after the other, so nothing but the present image is in memory; any iterable of
# grey images works, a video as well. The default settings are spelt out here to show where to change them.

settings = Settings(residuals="outline", solver="levenberg-marquardt", filter="kalman")
result = track(images(scene), scene.model, scene.camera, scene.start, scene.fps, settings)

# %%
# How far off is it, and does it know? A sigma is honest if about 95 % of the errors stay within two of it.

error = np.degrees(result.q - scene.truth)
rmse = np.sqrt(np.mean(error**2, axis=0))
inside = np.mean(np.abs(result.q - scene.truth) < 2.0 * result.sigma)
for name, value in zip(result.joint_names, rmse, strict=True):
    print(f"{name:12s} RMSE {value:.3f} degrees")
print(f"{100 * inside:.0f} % of the true angles lie within two sigmas")
print(f"status: {', '.join(f'{np.sum(result.status == s)} {s}' for s in sorted(set(result.status)))}")
print(f"{1e3 * np.median(result.seconds):.1f} ms a frame")

# %%
# Each joint: its estimated angle over the true one (right axis), and the error in its band of two sigmas (left axis).

figure, axes = plt.subplots(3, 3, figsize=(12, 8), layout="constrained", height_ratios=[1.2, 1.0, 1.0])
for axis, number in zip(axes[0], (0, 19, 39), strict=True):
    axis.imshow(image(scene, number), cmap="gray", vmin=0, vmax=255)
    axis.set(title=f"frame {number}", xticks=[], yticks=[])
for joint, name in enumerate(result.joint_names):
    row, column = 1 + joint // 3, joint % 3
    axis, band = axes[row, column], np.degrees(2.0 * result.sigma[:, joint])
    axis.fill_between(result.frame, -band, band, alpha=0.25, label="two sigmas")
    axis.plot(result.frame, error[:, joint], label="error")
    axis.set(title=f"{name}, RMSE {rmse[joint]:.2f} deg", ylim=(-1.5, 1.5), ylabel="degrees")
    angle = axis.twinx()
    angle.plot(result.frame, np.degrees(scene.truth[:, joint]), "k--", lw=1, label="true angle")
    angle.plot(result.frame, np.degrees(result.q[:, joint]), color="tab:green", lw=1, label="estimated angle")
lines = [line for axis in (axes[1, 0], angle) for line in axis.get_legend_handles_labels()[0]]
figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize="small")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Tracks two rendered fingers and compares with the truth.")
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=110)
