"""
Observability: what one view can and cannot tell
================================================

A finger bends in one plane. Seen from the side every joint shows; the nearer the view comes to that plane, the less:
the image then knows how far the tip reaches, and the angles only together. Near the image plane a second pose even
looks the same, folded to the other side.

Run ``python examples/07_observability.py --out observability.png`` to keep the picture.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from handtrack.camera import orthographic
from handtrack.folds import fold_candidates
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.measure import posed
from handtrack.observability import UNKNOWN, directions
from handtrack.profiles import place_outline
from handtrack.residuals import OutlineFeatures, chain, in_world, outline_residuals
from synth.render import render
from synth.scene import LIGHT, about_x, skin

# %%
# An index finger, a little bent, and a camera that turns about the finger's length: at 0 degrees the finger bends in
# the image plane, at 90 degrees towards the camera. Edges stand along the outline, each sure to a tenth of a pixel.

model = builtin_model("index")
u = np.radians([6.0, 8.0, 5.0])


def seen_from(tilt):
    return chain(model, orthographic(360, 160, 3.2, 50.0, 80.0, about_x(np.radians(tilt)), np.zeros(3)))


def outline(on):
    at = place_outline(posed(on, u), on.camera, model.link_is_tip)
    return OutlineFeatures(*in_world(on.camera, at.ray, at.slope), at.link, np.full(at.link.size, 0.1))


# %%
# Their Jacobian gives the information of the image, ``A = J^T J``: the inverse roots of its eigenvalues are the sigmas
# along the directions that it tells apart.

tilts = np.linspace(0.0, 90.0, 46)
A = np.array([J.T @ J for J in (outline_residuals(on, outline(on), u)[1] for on in map(seen_from, tilts))])
values = np.linalg.eigvalsh(A + np.eye(3) / UNKNOWN**2)
for tilt in (0.0, 60.0, 84.0, 90.0):
    weak = directions(A[np.searchsorted(tilts, tilt)], np.radians(0.5))[0]
    print(f"{tilt:.0f} degrees, directions open by half a degree:", weak.round(2).tolist())
folded = fold_candidates(seen_from(90.0), u, np.eye(3) * np.radians(8.0) ** 2)
print("poses with the same outline at 90 degrees:", np.degrees(folded).round(1).tolist())

# %%
# The finger from three sides, the sigmas, and the outline on the straight way to the pose with the knuckle folded.

figure, axes = plt.subplot_mosaic([list("abc"), list("sww")], figsize=(12, 6.2), layout="constrained")
way, step = np.linspace(-0.3, 1.3, 81), folded[np.argmin(folded[:, 0])] - u
for name, tilt in zip("abc", (0.0, 60.0, 90.0), strict=True):
    on = seen_from(tilt)
    axes[name].imshow(render(posed(on, u), on.camera, skin(model), LIGHT), cmap="gray")
    axes[name].set(title=f"seen from {tilt:.0f} degrees", xticks=[], yticks=[])
for tilt in (60.0, 80.0, 90.0):
    on = seen_from(tilt)
    off = [0.1 * np.sqrt(np.mean(outline_residuals(on, outline(on), u + t * step)[0] ** 2)) for t in way]
    axes["w"].plot(np.degrees(u[0] + way * step[0]), off, label=f"seen from {tilt:.0f} degrees")
axes["w"].set(title="change of the outline on the way to the fold (pixels)", xlabel="index_mcp (degrees)", ylim=(0, 2))
axes["w"].legend(loc="upper left")
axes["s"].semilogy(tilts, np.degrees(1.0 / np.sqrt(values)))
axes["s"].set(title="sigma along three directions", xlabel="tilt (degrees)", ylabel="degrees")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Shows which joint angles of a finger one view can tell.")
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=110)
