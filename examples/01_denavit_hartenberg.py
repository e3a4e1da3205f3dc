"""
From Denavit-Hartenberg rows to a bending finger
================================================

A finger is a chain of frames. Each row of its table places one frame on the one before it with four numbers (modified
Denavit-Hartenberg convention, eq. (2.1) of the hand thesis): turn by ``alpha`` about x, move by ``a`` along x, turn by
``theta`` about z, move by ``d`` along z. A joint moves ``theta``. Multiplying the frames along the chain gives the
place of every link, eq. (2.2); here for an index finger (Table 2.2) that bends at its three joints.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from handtrack.kinematics import FrameRow, forward, link_ends, model_from_rows, point_jacobian

parser = argparse.ArgumentParser(description="Draws a bending index finger from its Denavit-Hartenberg table.")
parser.add_argument("--out", help="file to save the figure to; nothing is saved without it")
out = parser.parse_known_args()[0].out

# %%
# The table
# ---------
# Three parallel axes: every ``alpha`` is zero, and each ``a`` is the length of the link before. Lengths in millimetres,
# angles in radians. ``link_length`` and ``link_radius`` hang a pill along the x axis of the frame.

rows = [
    FrameRow(1, parent=0, joint="mcp", link_length=46.0, link_radius=(10.0, 10.0)),
    FrameRow(2, parent=1, a=46.0, joint="pip", link_length=27.0, link_radius=(9.0, 9.0)),
    FrameRow(3, parent=2, a=27.0, joint="dip", link_length=11.0, link_radius=(8.0, 8.0)),
]
finger = model_from_rows("index", rows)

# %%
# Frames of many poses at once
# ----------------------------
# ``forward`` takes one pose or any batch of poses. A real finger bends its last two joints together.

bend = np.radians(np.linspace(0, 80, 7))
poses = np.stack([0.6 * bend, bend, 0.67 * bend], axis=-1)
frames = forward(finger, poses)
base, tip = link_ends(finger, frames)
print("frames:", frames.shape, " fingertip of the straight finger:", tip[0, -1].round(1))

# %%
# The Jacobian
# ------------
# How the fingertip moves when one joint turns: ``z x (p - o)`` for each joint axis ``z`` through ``o``. A short step
# must agree with the frames themselves.

middle = 3
jacobian = point_jacobian(finger, frames[middle], np.array([2]), tip[middle, -1:])[0]
step = 1e-6
moved = link_ends(finger, forward(finger, poses[middle] + [0, step, 0]))[1][-1]
print("d tip / d pip:", jacobian[:, 1].round(3), " by difference:", ((moved - tip[middle, -1]) / step).round(3))

# %%
# The picture
# -----------

figure, axes = plt.subplots(figsize=(6, 5))
for i, colour in enumerate(plt.get_cmap("viridis")(np.linspace(0, 0.9, len(poses)))):
    chain = np.vstack([base[i], tip[i, -1:]])
    axes.plot(chain[:, 0], chain[:, 1], "-o", color=colour, label=f"PIP {np.degrees(bend[i]):.0f} deg")
axes.plot(tip[:, -1, 0], tip[:, -1, 1], "k:", lw=1)
axes.quiver(
    *tip[middle, -1, :2], *jacobian[:2, 1], angles="xy", scale_units="xy", scale=1.5, color="tab:red", width=5e-3
)
axes.set(title="An index finger bends", xlabel="x of frame {0}, mm", ylabel="y of frame {0}, mm", aspect="equal")
axes.legend(fontsize="small")
if out:
    figure.savefig(out, dpi=120)
if plt.get_backend().lower() != "agg":  # matplotlib falls back to it where there is no display
    plt.show()
