"""
Inertial suit and one camera
============================

A person walks laps in a room. The inertial suit knows the posture, but drifts; one camera sees the person in 60 % of
its frames. A filter on the four numbers of the drift, place and heading, brings both together. The walk is simulated,
so that the truth is known.
``python examples/13_walk.py --out walk.png`` keeps the picture; ``handtrack body walk FOLDER --out RUN`` writes a page
in which the skeleton can be turned and played.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.body.suit_body import body_of_walk
from handtrack.body.walk_run import follow_walk
from handtrack.body.walk_settings import Settings
from handtrack.report.walk_facts import spans, walk_facts
from synth.walk import WalkSettings, make_walk

# %%
# Segments of the suit in its own drifting frame, and keypoints of the camera in pixels.

scene = make_walk(seed=3, settings=WalkSettings(seconds=60.0))
walk = scene.walk
print(f"{walk.frame.size} frames of the suit, {walk.camera_frame.size} of the camera")

# %%
# The suit alone, the paper's particle filter, and an error-state filter.

body = body_of_walk(walk)
tracks = {method: follow_walk(walk, body, Settings(method=method), seed=1) for method in ("suit", "drift-ff", "eskf")}
facts = {method: walk_facts(track, None, walk.truth) for method, track in tracks.items()}
for method, found in facts.items():
    print(f"{method}: {found.sentences()[1]}")

# %%
# The path from above with two sigma, and the error over time; grey: out of view.

figure, (plan, over) = plt.subplots(1, 2, figsize=(12, 4.8), layout="constrained", width_ratios=[1, 1.5])
colours = {"suit": "tab:brown", "drift-ff": "tab:blue", "eskf": "tab:green"}
last = walk.time > walk.time[-1] - 15.0
for method, track in tracks.items():
    plan.plot(*track.p[last, :2].T, color=colours[method], label=method)
    over.plot(walk.time, 1e3 * facts[method].errors.place, color=colours[method], label=method)
ours = tracks["drift-ff"]
turn = np.linspace(0.0, 2.0 * np.pi, 40)
for n in np.flatnonzero(last)[::5]:
    plan.fill(
        *(ours.p[n, :2, None] + 2 * ours.sigma[n, :2, None] * [np.cos(turn), np.sin(turn)]), "tab:blue", alpha=0.12
    )
plan.plot(*walk.truth.p[last, :2].T, "k:", label="truth")
plan.set(title="the last 15 s from above (m)", aspect="equal")
over.plot(walk.time, 2e3 * np.linalg.norm(ours.sigma, axis=1), "--", color="tab:blue", lw=1, label="drift-ff, 2σ")
for first, end in spans(~ours.in_view):
    over.axvspan(walk.time[first], walk.time[end], color="0.5", alpha=0.15, lw=0)
over.set(title="error of the pelvis (mm); grey: out of view", xlabel="seconds", ylim=(0, None))
for panel in (plan, over):
    panel.legend(fontsize=8)

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=100)
