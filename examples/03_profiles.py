"""
Profiles: from samplers on a finger to the valley of a curve
============================================================

Short straight paths, the samplers, cross the outline of two posed fingers; where one finger hides the other, no edge is
looked for. Interpolation turns each path into a profile of grey levels (hand thesis, section 4.2). A template says what
the profile should look like; the squared differences of the two, over the visible samples and for every shift of the
template, make the WSSD curve: its valley tells how far the finger is from where the pose put it (section 4.3).
``--out profiles.png`` keeps the picture.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.appearance import learn
from handtrack.edges import FOUND, curves, find_edges
from handtrack.kinematics import forward
from handtrack.pills import pose_pills
from handtrack.profiles import place_across, place_outline, sample
from handtrack.templates import expect, positions
from synth.scenes import image, posed, two_finger_crossing

# %%
# The surface's grey levels are learnt where the pose is known; in the crossing it is predicted, 1.5 degrees off.

scene = two_finger_crossing(seed=4, frames=30, noise=2.0, max_speed=3.0)
camera, fingers, frame = scene.camera, scene.model.link_finger, 15
known, picture = learn(image(scene, 0), posed(scene, 0), camera), image(scene, frame)
pills = pose_pills(scene.model, forward(scene.model, scene.truth[frame] + np.radians(1.5)), camera)

# %%
# Samplers, their templates and windows, and profiles that are longer than the templates, so that these can move.

samplers = place_outline(pills, camera, scene.model.link_is_tip, spacing=14.0)
templates = expect(samplers, pills, fingers, camera, known)
profiles = sample(picture, samplers, positions(20.0, 14.0, 0.5))
surface = curves(profiles, templates)
wide = np.full(samplers.link.size, 8.0)
edges = find_edges(samplers, templates, profiles, wide, wide, known.noise, known.spread)
found, hidden = edges.reason == FOUND, templates.state == 1
one = np.argmin(np.where(found & (np.abs(np.abs(edges.offset) - 4.0) < 1.0), edges.sigma, np.inf))
print(f"{found.sum()} of {found.size} samplers found an edge, {hidden.sum()} are hidden by the other finger")
print(f"sampler {one}: the edge lies {edges.offset[one]:+.2f} +- {edges.sigma[one]:.2f} px from where the pose put it")

# %%
# As in Figure 4.6, a profile of 20 points by the three ways to interpolate; here over the edge of one link.

across, near = place_across(pills, camera, 1), np.linspace(24.0, 35.0, 20)
figure, ((a, b), (c, d)) = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
a.imshow(picture, cmap="gray", vmin=0, vmax=255)
for chosen, colour, label in ((found, "tab:green", "edge found"), (hidden, "tab:red", "hidden by the other finger")):
    ends = samplers.origin[chosen, None] + np.array([[-8.0], [8.0]]) * samplers.direction[chosen, None]
    a.plot(*ends.transpose(2, 1, 0), color=colour, lw=1, label=[label] + ["_"] * (chosen.sum() - 1))
a.plot(*edges.xy[found].T, ".", color="gold", ms=4, label="edge point")
a.plot(*samplers.origin[one], "o", mfc="none", color="tab:orange", label=f"sampler {one}")
a.set(title="samplers on the predicted outline", xlim=(120, 540), ylim=(330, 110))
a.legend(loc="lower right", fontsize="small")
for method in ("nearest", "bilinear", "bicubic"):
    b.plot(near, sample(picture, across, near, method).values[3], ".-", label=method)
b.set(title="20 points over an edge, three interpolations", xlabel="place across the link (px)", ylabel="grey level")
c.plot(profiles.u, profiles.values[one], ".-", label="profile")
c.plot(templates.u, templates.values[one], color="tab:orange", label="template")
c.plot(templates.u + edges.offset[one], templates.values[one], ":", color="tab:orange", label="template, moved")
c.set(title=f"template and profile of sampler {one}", xlabel="place along it (px)", ylabel="grey level")
d.plot(0.5 * np.arange(surface.shape[1]) - 8.0, surface[one], ".-", label="WSSD")
d.axvline(edges.offset[one], color="gold", label=f"valley at {edges.offset[one]:+.2f} px")
d.set(title="its WSSD curve", xlabel="shift of the template (px)", ylabel="mean squared difference", yscale="log")
for axes in (b, c, d):
    axes.legend(fontsize="small")

parser = argparse.ArgumentParser(description="Samplers, profiles, templates and the WSSD curve of two fingers.")
parser.add_argument("--out", help="file for the picture; without it nothing is written")
if out := parser.parse_known_args()[0].out:
    figure.savefig(out, dpi=110)
