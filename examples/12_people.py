"""
People in view
==============

Two people hand a box over. A pose network reports their skeletons with jitter, holes, swaps and false people, and the
box hides the operator's left wrist. The permanence filter labels them and follows every keypoint, seen or not. The
recording is simulated, so that the truth is known.
``python examples/12_people.py --out people.png`` keeps the picture; ``handtrack body people SCENE --out RUN`` writes a
page in which everybody can be turned and played.
"""

import argparse

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from handtrack.body.people_metrics import accuracy, course_of, labels_of, main_labels
from handtrack.body.people_run import run, settings_for
from handtrack.formats.people import PREDICTED
from handtrack.formats.skeletons import KEYPOINTS
from synth.people_tasks import TaskSettings, make_task

# %%
# Skeletons as a depth camera and a pose network report them: metres, with confidences, in any order.

task = make_task("T3", seed=3, settings=TaskSettings(frames=240))
seen, truth = task.detections, task.truth
print(f"{seen.time.size} frames, {seen.frame.size} skeletons")

# %%
# Steady people, and the raw measurements that belong to each of them. Person 0 of the truth is the operator.

found = run(seen, settings_for("robust"), seed=1)
operator = int(main_labels(labels_of(found.people, truth))[0])
wrist = KEYPOINTS.index("left_wrist")
real = truth.p[:, 0, wrist]
courses = {name: course_of(people, operator, wrist) for name, people in (("raw", found.raw), ("ours", found.people))}
for name, course in courses.items():
    score = accuracy(seen.time, course.p, real)
    print(f"{name}: MAE {1e3 * score.mae:.0f} mm, STD {1e3 * score.std:.0f} mm, ACC {score.acc:.1f} m/s²")

# %%
# The wrist over time with two sigmas, blue where it is predicted; and everybody's hips from above.

figure = plt.figure(figsize=(12, 5), layout="constrained")
panels = figure.subplot_mosaic([["x", "plan"], ["y", "plan"], ["z", "plan"]], width_ratios=[1.7, 1])
ours = courses["ours"]
for i, axis in enumerate("xyz"):
    sigma = np.sqrt(ours.covariance[:, i, i])
    panel = panels[axis]
    panel.fill_between(seen.time, ours.p[:, i] - 2 * sigma, ours.p[:, i] + 2 * sigma, color="tab:orange", alpha=0.25)
    panel.plot(seen.time, courses["raw"].p[:, i], ".", ms=3, color="0.6", label="measured")
    panel.plot(seen.time, ours.p[:, i], color="tab:orange", label="followed, ±2σ")
    panel.plot(seen.time, real[:, i], "k:", lw=1.2, label="truth")
    hidden = ours.status == PREDICTED
    panel.fill_between(
        seen.time, 0, 1, hidden, color="tab:blue", alpha=0.1, transform=panel.get_xaxis_transform(), lw=0
    )
    panel.set(ylabel=f"{axis} (m)", ylim=(real[:, i].min() - 0.25, real[:, i].max() + 0.25))
panels["x"].set_title("left wrist of the operator; blue: not seen, or not believed")
panels["x"].legend(ncols=3, fontsize=8, loc="upper right")
panels["z"].set_xlabel("seconds")
for label in np.unique(found.people.person):
    hips = course_of(found.people, int(label), KEYPOINTS.index("mid_hip")).p
    panels["plan"].plot(hips[:, 0], hips[:, 2], label=f"person {label}")
panels["plan"].plot(0, 0, "k^", label="camera")
panels["plan"].set(title="hips from above (m)", aspect="equal", xlabel="right", ylabel="away from the camera")
panels["plan"].legend(fontsize=8)

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=100)
