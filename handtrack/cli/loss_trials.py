"""Seeded losses in, each rendered and tracked with a score for every frame and finger out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from synth.loss_scenes import KINDS, Kind, Loss, loss_pictures, loss_scene
from synth.scripted import finger_joints, finger_names

from ..reproduce.loss_detection import FALSE_ALARMS, LossRow, LossRun, Roc, threshold_at
from ..residuals import Chain, chain
from ..settings import Settings
from ..track import LOST
from ..tracker import Frame, State, begin, step


@dataclass(frozen=True, slots=True)
class LossJob:
    """One injection and how it is tracked."""

    kind: Kind
    seed: int
    settings: Settings


def finger_scores(frame: Frame, on: Chain) -> Float[np.ndarray, " f"]:
    """How sure the tracker is of each finger, 0 to 1: the one place that says where the score comes from.

    The share of the edges expected of the finger that were found; the frame's own confidence where none is expected.
    """
    finger = on.model.link_finger
    count = int(finger.max()) + 1
    expected, found = np.zeros(count), np.zeros(count)
    for view in frame.estimate.seen:
        its = finger[view.samplers.link]
        expected += np.bincount(its[view.expected], minlength=count)
        found += np.bincount(its[view.found], minlength=count)
    if frame.estimate.fit is None:
        return np.zeros(count)
    return np.where(expected > 0, found / np.maximum(expected, 1.0), frame.confidence)


def told(state: State, q: Float[np.ndarray, " j"], on: Chain) -> State:
    """The state of a tracker that believes another pose; its velocities and sigmas stay."""
    x = state.prediction.motion.x.copy()
    u = q[on.model.free]
    x[: u.size] = u
    motion = replace(state.prediction.motion, x=x)
    return replace(state, prediction=replace(state.prediction, motion=motion), rivals=())


def followed(loss: Loss, settings: Settings) -> LossRun:
    """Track a scene and inject its loss."""
    it = loss.scene
    on = (chain(it.model, it.camera),)
    state, q, scores, called = begin(on, it.start, it.fps, settings), [], [], []
    for number, image in enumerate(loss_pictures(loss)):
        if loss.forced is not None and number == loss.at:
            state = told(state, loss.forced, on[0])
        state, frame = step(state, (image,), on, 1.0 / it.fps if number else 0.0, settings)
        q.append(frame.q)
        scores.append(finger_scores(frame, on[0]))
        called.append(frame.status == LOST)
    off = np.abs(np.array(q) - it.truth)
    names = finger_names(it.model)
    number = np.arange(it.truth.shape[0])
    return LossRun(
        kind=loss.kind,
        at=loss.at,
        until=loss.until,
        worst=np.column_stack([off[:, finger_joints(it.model, name)].max(axis=1) for name in names]),
        score=np.array(scores),
        struck=loss.struck,
        dark=loss.dark & (number >= loss.at) & (number < loss.until),
        called_lost=np.array(called),
    )


def loss_tried(job: LossJob) -> LossRun:
    """Render and track one scene."""
    return followed(loss_scene(job.kind, job.seed), job.settings)


def loss_suite(seeds: int, first_seed: int, settings: Settings) -> list[LossJob]:
    """Every kind of injection, and none, with every seed."""
    return [LossJob(kind, first_seed + i, settings) for kind in KINDS for i in range(seeds)]


def loss_figure(curve: Roc, rows: Sequence[LossRow]) -> Figure:
    """The ROC, with the threshold of 1 % false alarms marked, beside what it tells and recovers of each kind."""
    drawn = Figure(figsize=(12.0, 4.2), layout="constrained")
    left, right = drawn.subplots(1, 2)
    floor = 3e-4
    left.step(np.maximum(curve.false_alarms, floor), 100.0 * curve.told, where="post", color="#4c78a8")
    left.axvline(FALSE_ALARMS, color="black", lw=0.8, ls=":", label=f"score {threshold_at(curve):.3f}")
    left.set(xscale="log", xlim=(floor, 1.0), ylim=(0, 102))
    left.set(xlabel="false alarms, share of the fingers in calm frames", ylabel="lost fingers told (%)")
    left.set_title(f"frame by frame; area {curve.area:.4f}", loc="left")
    left.legend(frameon=False, loc="lower right")
    at = np.arange(len(rows))
    prompt = [100.0 * row.prompt / max(row.events, 1) for row in rows]
    back = [100.0 * row.recovered / max(row.struck, 1) for row in rows]
    right.bar(at - 0.2, prompt, 0.38, color="#f58518", label="told within 5 frames")
    right.bar(at + 0.2, back, 0.38, color="#54a24b", label="recovered")
    right.set_xticks(at, [row.kind for row in rows])
    right.set(ylabel="% of the fingers", ylim=(0, 112))
    right.legend(frameon=False, ncols=2, loc="upper left")
    for panel in (left, right):
        panel.grid(color="#e2e5ea", linewidth=0.8)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    return drawn
