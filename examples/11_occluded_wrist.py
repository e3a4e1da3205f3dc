"""
A wrist that the camera cannot see
==================================

A person reaches into a shelf whose side wall hides the wrist. A particle filter keeps a cloud of where it can be: a
forearm away from the elbow, in the arm's plane, not where the camera sees something farther away, and not through the
room's walls. The cell is simulated, so that the truth is known.
``python examples/11_occluded_wrist.py --out wrist.png`` keeps the picture;
``handtrack body wrist SCENE --out RUN`` writes a page in which the cloud can be turned and played.
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.body.wrist_run import arm_of, run, settings_for
from handtrack.camera import project
from handtrack.formats.rgbd import read_depth, read_rgbd
from handtrack.formats.skeletons import KEYPOINTS
from handtrack.report.wrist_facts import facts_of
from synth.cell import CellSettings, simulate_cell

# %%
# A scene folder: depth images, what the sensor's body tracker says of each keypoint, the room as a mesh, and the truth.

folder = Path(tempfile.mkdtemp()) / "cell"
simulate_cell(folder, seed=2, settings=CellSettings(frames=110, fps=12.0, width=160, height=120, occlusion="static"))
scene = read_rgbd(folder)
arm = arm_of(scene.detections)
if scene.truth is None:
    raise SystemExit("the simulator writes a truth; there is none")
truth = scene.truth.p[:, 0, KEYPOINTS.index("right_wrist")]

# %%
# The thesis's first filter knows the forearm's length and the depth map; `complete` knows the arm and the room too.

tracks = {name: run(scene, settings_for(name, particles=1000)) for name in ("original", "complete")}
facts = {name: facts_of(track, arm.state[:, 2], arm.p[:, 2], truth) for name, track in tracks.items()}
for name, found in facts.items():
    print(f"{name}: {found.sentences()[0]}")

# %%
# Both clouds in the depth image of a hidden frame, and errors and volumes over time.

hidden = facts["complete"].hidden
frame = int(np.flatnonzero(hidden)[hidden.sum() // 4])
figure = plt.figure(figsize=(12, 4.6), layout="constrained")
panels = figure.subplot_mosaic([["image", "error"], ["image", "volume"]], width_ratios=[1, 1.1])
panels["image"].imshow(read_depth(scene, frame), cmap="Greys", vmin=1.0, vmax=4.0)
for (name, track), colour in zip(tracks.items(), ("tab:orange", "tab:blue"), strict=True):
    u, v = project(scene.camera, track.cloud[frame].astype(float)).T
    panels["image"].plot(u, v, ".", ms=3, alpha=0.6, color=colour, label=f"particles, {name}")
    panels["error"].plot(track.time, 1e3 * np.linalg.norm(track.mean - truth, axis=1), color=colour, label=name)
    panels["volume"].semilogy(track.time, 1e3 * track.volume, color=colour)
panels["image"].plot(*project(scene.camera, truth[frame : frame + 1]).T, "+", color="red", ms=14, mew=2, label="truth")
panels["image"].set(title=f"depth, frame {frame}", xlim=(0, 159), ylim=(119, 0), xticks=[], yticks=[])
for name, words in (("error", "error (mm)"), ("volume", "95 % ellipsoid (litres)")):
    panels[name].fill_between(
        scene.detections.time, 0, 1, hidden, color="0.9", transform=panels[name].get_xaxis_transform()
    )
    panels[name].set(ylabel=words)
panels["volume"].set(xlabel="seconds; grey where the sensor does not see the wrist")
panels["image"].legend(loc="lower left", fontsize=8)
panels["error"].legend(frameon=False)

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=100)
