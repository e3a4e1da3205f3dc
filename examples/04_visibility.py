"""
Visibility: what one finger leaves of another
=============================================

Two fingers cross in the image. Each link is a pill; its silhouette, less the silhouettes of the links in front of it,
is its truncated polygon (hand thesis, Figure 4.17). The window function of a link's samplers says which of their
samples fall inside that polygon (Figure 4.18), so that a hidden sample never enters a comparison of profiles.

Run ``python examples/04_visibility.py --out visibility.png`` to keep the picture.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from shapely.plotting import plot_polygon

from handtrack.camera import perspective, project_camera
from handtrack.pills import Pills
from handtrack.visibility import truncated_polygons, visible_fraction, visible_samples, window

# %%
# Two fingers of three tapered links each, in camera axes (x right, y down, z forward; millimetres).
# The first lies across the second, 60 mm nearer to the camera.


def finger(start: list[float], turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends and radii of three links that lead from `start` in the direction `turn`, each bent a little more."""
    step = np.array([[np.cos(a), np.sin(a), 0.2] for a in turn + np.radians([0.0, 12.0, 24.0])])
    joints = np.array(start) + np.vstack([np.zeros(3), np.cumsum(step * [[46.0], [28.0], [22.0]], axis=0)])
    return joints[:-1], joints[1:], np.array([[9.5, 9.0], [9.0, 8.0], [8.0, 7.0]])


camera = perspective(320, 240, 550.0, 550.0, 160.0, 120.0, np.eye(3), np.zeros(3))
near, far = finger([-45.0, -10.0, 400.0], 0.1), finger([10.0, -42.0, 460.0], 1.5)
pills = Pills(*(np.concatenate(parts) for parts in zip(near, far, strict=True)))
fingers = np.array([0, 0, 0, 1, 1, 1])

# %%
# Truncated polygons. ``pairwise`` compares two links on a ray through their overlap; the thesis's ``mean-depth`` gives
# the same here, and goes wrong only where a long link leads away from the viewer (Figure 4.16).

layers = truncated_polygons(pills, camera, fingers, order="pairwise")
for link, share in enumerate(visible_fraction(layers)):
    print(f"finger {fingers[link]}, link {link % 3}: {100 * share:5.1f} % visible")

# %%
# Samplers across one link of the far finger: four lines of 61 samples, over three diameters. Polygons and rays agree.

link, samples = 3, np.linspace(-1.5, 1.5, 61)
base, tip = project_camera(camera, np.stack([pills.base[link], pills.tip[link]]))
along = (tip - base) / np.hypot(*(tip - base))
across = np.array([-along[1], along[0]]) * 2.0 * 550.0 * pills.radius[link].mean() / pills.base[link, 2]
xy = base + np.linspace(0.15, 0.85, 4)[:, None, None] * (tip - base) + samples[:, None] * across
seen = window(layers.truncated[link], xy)
rays = visible_samples(pills, camera, np.full(seen.size, link), xy.reshape(-1, 2), fingers).reshape(seen.shape)
print(f"{seen.sum()} of {seen.size} samples inside the polygon; the rays agree on {100 * np.mean(rays == seen):.1f} %")

# %%
# The polygons with the samplers on the left, the window functions on the right.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for k, polygon in enumerate(layers.truncated):
    plot_polygon(polygon, ax=left, add_points=False, color=f"C{k}", alpha=0.6)
left.scatter(*xy[seen].T, s=3, color="black", label="window 1")
left.scatter(*xy[~seen].T, s=3, color="lightgrey", label="window 0")
left.set(xlim=(0, 320), ylim=(240, 0), aspect="equal", title="truncated polygons", xlabel="x (px)", ylabel="y (px)")
left.legend(loc="lower left")
right.imshow(seen, aspect="auto", cmap="gray", interpolation="nearest", extent=(-1.5, 1.5, 3.5, -0.5))
right.set(title=f"window functions of link {link}", xlabel="place across the link (diameters)", ylabel="sampler")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Truncated polygons and window functions of two crossing fingers.")
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=110)
