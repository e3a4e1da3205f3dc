"""
Edge methods: seven ways to read a profile
==========================================

A profile across a phalanx is bright where the finger is; its two edges are wanted. The hand thesis (appendix D) takes
the steepest places of the derivative, then lets the known width of the phalanx restrict the search, then asks the
edges of all profiles of a phalanx to lie on straight lines. Every method is one function with the same signature, so
they can be tried side by side. ``--out methods.png`` keeps the picture.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.across import crossings
from handtrack.appearance import learn
from handtrack.edges.derivative import gaussian_slopes, plain_slopes
from handtrack.edges.rectilinear import along_link, fit_iterative, fit_mwplls, fit_plls
from handtrack.edges.width_restricted import correlate
from handtrack.kinematics import forward
from handtrack.measure_crossings import METHODS
from handtrack.pills import pose_pills
from handtrack.profiles import place_across
from synth.scenes import image, posed, two_finger_crossing

# %%
# A frame, and a prediction that is off by 1.5 degrees in every joint. Profiles are laid across the predicted links.

scene = two_finger_crossing(seed=0, frames=12, noise=4.0)
camera, fingers, frame = scene.camera, scene.model.link_finger, 5
picture, true = image(scene, frame), posed(scene, frame)
pills = pose_pills(scene.model, forward(scene.model, scene.truth[frame] + np.radians(1.5)), camera)
samplers = place_across(pills, camera, 8)
reach, spread = np.full(samplers.link.size, 16.0), np.full(samplers.link.size, 3.0)
given = crossings(picture, pills, fingers, camera, learn(picture, true, camera), samplers, reach, spread)

# %%
# What each method finds on all links, and how the edges move from where the prediction puts them.

one = np.flatnonzero(samplers.link == 2)[4]
for method in METHODS:
    edges = method(given)
    moved, found = np.round(edges.offset[2 * one :][:2], 2), np.isfinite(edges.sigma)
    print(f"{method.__name__:17} {found.sum():3} edges; on profile {one}: {moved} px outwards")

# %%
# The criteria of one profile, and the correlation surface of its phalanx with the three lines.

plain, smooth, x = plain_slopes(given), gaussian_slopes(given), along_link(given)
surface = correlate(given, smooth)
figure, ((a, b), (c, d)) = plt.subplots(2, 2, figsize=(11, 7.5), layout="constrained")
a.plot(given.profiles.u, given.profiles.values[one], color="black")
a.vlines(given.edge[one], 0, 200, color="0.5", ls=":", label="predicted edge")
for n, method in enumerate(METHODS):
    place = (method(given).xy[2 * one :][:2] - samplers.origin[one]) @ samplers.direction[one]
    a.plot(place, [25 * n + 20] * 2, "o", label=method.__name__)
a.set(title="profile and edges", xlabel="place across the phalanx (px)", ylabel="grey level", xlim=(-55, 85))
a.legend(fontsize="small", loc="right")
for slopes, name in ((plain, "difference"), (smooth, "gaussian")):
    b.plot(slopes.u, np.where(slopes.usable[one], slopes.values[one], np.nan), label=name)
b.set(title="derivatives", xlabel="place across the phalanx (px)", ylabel="grey levels per pixel")
c.plot(surface.shift, np.where(surface.allowed[one], surface.curves[one], np.nan), color="tab:red")
c.set(title="correlation with a template of two peaks", xlabel="shift (px)", ylabel="grey levels per pixel")
mine = np.flatnonzero((samplers.link == 2) & surface.allowed.any(axis=1))
d.pcolormesh(x[mine], surface.shift, surface.curves[mine].T, shading="nearest")
for fit, style in ((fit_plls, "--"), (fit_mwplls, ":"), (fit_iterative, "-")):
    d.plot(x[mine], fit(surface, x, samplers.link).shift[mine], style, color="white", label=fit.__name__[4:])
d.set(title="its phalanx: correlation surface and lines", xlabel="place along it (px)", ylabel="shift (px)")
b.legend(fontsize="small")
d.legend(fontsize="small", facecolor="0.4", labelcolor="white")

parser = argparse.ArgumentParser(description="Every edge method on one profile across a phalanx.")
parser.add_argument("--out", help="file for the picture; without it nothing is written")
if out := parser.parse_known_args()[0].out:
    figure.savefig(out, dpi=110)
