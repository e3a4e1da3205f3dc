"""
A finger that nothing shows
===========================

One of two fingers that look alike hides the other wholly for twenty frames, and leaves again. While no pixel shows
the hidden finger its pose is a guess, and the stated sigmas have to say so. The scene is scripted, so that the truth
and the visible share of the finger are known exactly.
``python examples/14_hidden_finger.py --out hidden.png`` keeps the picture;
``handtrack benchmark occlusion`` measures many such scenes.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.tracker import track
from synth.occlusion_scenes import occlusion_scene
from synth.scripted import finger_names, pictures

# %%
# The middle finger goes on moving behind the index finger.

scripted = occlusion_scene("hidden", seed=5, frames=20, motion="on")
scene = scripted.scene
share = scripted.finger_share[:, finger_names(scene.model).index(scripted.watched)]
images = list(pictures(scripted))
found = track(images, scene.model, scene.camera, scene.start, scene.fps)

# %%
# How far off is it while hidden, and how many of its joints lie within two of their stated sigmas?

off = np.degrees(found.q - scene.truth)[:, :3]
sigma = np.degrees(found.sigma)[:, :3]
rms = np.sqrt(np.mean(off[scripted.hidden] ** 2))
inside = np.mean(np.abs(off[scripted.hidden]) <= 2.0 * sigma[scripted.hidden])
print(f"hidden for {scripted.hidden.sum()} frames: error {rms:.1f} degrees, {100 * inside:.0f} % within two sigmas")

# %%
# Before, at the beginning, in the middle and after; then the error with two sigmas, and the visible share.

first, last = np.flatnonzero(scripted.hidden)[[0, -1]]
figure = plt.figure(figsize=(12, 6), layout="constrained")
panels = figure.subplot_mosaic([["a", "b", "c", "d"], ["error"] * 4, ["share"] * 4], height_ratios=[1.4, 1.2, 0.5])
for name, frame in zip("abcd", (first - 8, first - 2, (first + last) // 2, last + 6), strict=True):
    panels[name].imshow(images[frame][60:420, :420], cmap="gray", vmin=0, vmax=255)
    panels[name].set(title=f"frame {frame}", xticks=[], yticks=[])
number = np.arange(len(images))
for joint, colour in zip(range(3), ("tab:blue", "tab:orange", "tab:green"), strict=True):
    panels["error"].plot(number, off[:, joint], color=colour, label=scene.model.joint_names[joint].replace("_", " "))
    band = 2.0 * sigma[:, joint]
    panels["error"].fill_between(number, -band, band, color=colour, alpha=0.12, lw=0)
panels["error"].set(ylabel="error (degrees)", xlim=(0, number[-1]))
panels["error"].legend(frameon=False, ncols=3, loc="upper left")
panels["share"].fill_between(number, 100.0 * share, color="0.75")
panels["share"].set(ylabel="visible (%)", xlabel="frame", xlim=(0, number[-1]), ylim=(0, 100))

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=100)
