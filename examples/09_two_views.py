"""
Two views: what one camera cannot tell of depth
===============================================

A fingertip that moves along the line of sight hardly moves in the image, so one camera knows its place across the image
far better than its depth. A second camera, turned by 60 degrees, sees that motion from the side. Edge points of both
views go into one stacked residual; the hand is the full one of section 6.2.2 of the hand thesis.

Run ``python examples/09_two_views.py --out views.png`` to keep the picture.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.camera import camera_from_world
from handtrack.kinematics import forward, link_ends, point_jacobian
from handtrack.tracker import track
from synth.scenes import full_hand_spread, image, images_together
from synth.views import with_views

# %%
# One scene, two cameras. ``track`` takes a tuple of images at a time and as many cameras; all cameras stand in the same
# world, the base frame of the model.

scene = with_views(full_hand_spread(seed=4, frames=20), 2)
one = track((pair[:1] for pair in images_together(scene)), scene.model, scene.cameras[:1], scene.start, scene.fps)
two = track(images_together(scene), scene.model, scene.cameras, scene.start, scene.fps)

# %%
# Errors of the five fingertips in the axes of the first camera (x and y across its image, z in depth), and the sigma
# that the tracker states for them, carried over from the joints' covariance.

tips = scene.model.link_is_tip


def tip_errors(found):
    """Error of each tip in each frame, and its sigma, in camera axes and millimetres."""
    ends = np.stack([link_ends(scene.model, forward(scene.model, q))[1][:, tips] for q in (found.q, scene.truth)])
    estimated, true = camera_from_world(scene.camera, ends)
    sigma = []
    for q, covariance in zip(found.q, found.covariance, strict=True):
        frames = forward(scene.model, q)
        point = link_ends(scene.model, frames)[1][tips]
        J = scene.camera.R @ point_jacobian(scene.model, frames, scene.model.link_frame[tips], point)
        sigma.append(np.sqrt(np.einsum("tij,jk,tik->ti", J, covariance, J)))
    return estimated - true, np.array(sigma)


results = [(name, *tip_errors(found), found) for name, found in (("one view", one), ("two views", two))]
for name, error, sigma, found in results:
    rms, stated = np.sqrt(np.mean(error**2, axis=(0, 1))), np.sqrt(np.mean(sigma**2, axis=(0, 1)))
    worst = np.degrees(np.sqrt(np.mean((found.q - scene.truth) ** 2, axis=0)).max())
    print(f"{name}: tips off by {rms[0]:.3f} and {rms[1]:.3f} mm across the image, {rms[2]:.3f} mm in depth", end="; ")
    print(f"stated sigma in depth {stated[2]:.3f} mm; worst joint {worst:.2f} degrees")

# %%
# Above, what the two cameras see; below, the depth of the tip that one view knows least, in its band of two sigmas.

figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained", height_ratios=[1.4, 1.0], sharey="row")
tip = int(np.argmax(results[0][2][:, :, 2].mean(axis=0)))
for view, (name, error, sigma, _) in enumerate(results):
    axes[0, view].imshow(image(scene, 19, view), cmap="gray", vmin=0, vmax=255)
    axes[0, view].set(title=f"view {view}, last frame", xticks=[], yticks=[])
    band = 2.0 * sigma[:, tip, 2]
    axes[1, view].fill_between(one.frame, -band, band, alpha=0.25, label="two sigmas")
    axes[1, view].plot(one.frame, error[:, tip, 2], label="error")
    axes[1, view].set(title=f"depth of one fingertip, {name}", xlabel="frame", ylabel="error (mm)")
axes[1, 0].legend()

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Tracks a rendered hand from one and from two cameras.")
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=110)
