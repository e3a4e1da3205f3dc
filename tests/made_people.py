"""A person who faces the camera and whose bones are exactly those of the table, for tests of people in view."""

import numpy as np

from handtrack.body.skeleton_graph import SIDE
from handtrack.formats.skeletons import LOST, TRACKED, Detections


def figure(height: float = 1.75, at: tuple[float, float, float] = (0.0, 0.0, 2.2)) -> np.ndarray:
    """Keypoints (16, 3), metres, camera axes; the middle of the shoulders is 0.4 m above `at`; centre joints NaN."""
    half = np.array([
        [0.117, 0.0, 0.0], [0.117, 0.186, 0.0], [0.117, 0.186 + 0.073, -0.146 * np.sqrt(0.75)],
        [0.055, SIDE, 0.0], [0.055, SIDE + 0.245, 0.0], [0.055, SIDE + 0.491, 0.0],
    ])  # fmt: skip
    p = np.full((16, 3), np.nan)
    p[0:12:2], p[1:12:2] = half, half * (-1.0, 1.0, 1.0)
    return height * p + np.array(at) - [0.0, 0.4, 0.0]


def confidences(p: np.ndarray, value: float = 0.7) -> np.ndarray:
    """That of every keypoint that is there; 0 elsewhere."""
    return np.where(np.isnan(p[..., 0]), 0.0, value)


def recording(frames: list[np.ndarray], sure: list[np.ndarray] | None = None, fps: float = 30.0) -> Detections:
    """Detections of frames (m, 16, 3), m of any size; where nothing is said they are sure of what they see."""
    sure = [confidences(p) for p in frames] if sure is None else sure
    count = [p.shape[0] for p in frames]
    p = np.concatenate([*frames, np.zeros((0, 16, 3))])
    return Detections(
        np.arange(len(frames)) / fps,
        np.repeat(np.arange(len(frames)), count),
        np.concatenate([np.arange(0), *(np.arange(m) for m in count)]),
        p,
        np.concatenate([*sure, np.zeros((0, 16))]),
        np.where(np.isnan(p[..., 0]), LOST, TRACKED).astype(np.int8),
    )
