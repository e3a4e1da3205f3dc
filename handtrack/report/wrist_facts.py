"""A track of a wrist, what the sensor saw and the truth in; errors, coverage and distances to the robot out.

A frame is hidden where the sensor does not track the wrist, from the first time on that it did. There the error of the
estimate is held against that of the last position seen.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..body.particles import mahalanobis
from ..formats.robots import RobotVolume
from ..formats.wrists import WristTrack

QUANTILE_95 = 7.814727903251179  # of chi square with three degrees of freedom
LITRE = 1e-3  # m^3
RECOVERED = 0.05  # metres from the truth at which a wrist that is seen again counts as found


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """Figures of each frame.

    Attributes
    ----------
    hidden : (f,)
        Frames in which the sensor did not track a wrist that it had tracked before.
    volume : (f,)
        m^3.
    error, held, square : (f,) or None
        Distance from the truth, that of the last position seen, metres, and the squared Mahalanobis distance; NaN where
        the truth is not known. None without truth.
    robot, nearest : (f,) or None
        Distance from the cloud to the robot's surface, 5 % quantile and least, metres, below 0 inside. None without
        robot.
    """

    hidden: Bool[np.ndarray, " f"]
    volume: Float[np.ndarray, " f"]
    error: Float[np.ndarray, " f"] | None
    held: Float[np.ndarray, " f"] | None
    square: Float[np.ndarray, " f"] | None
    robot: Float[np.ndarray, " f"] | None
    nearest: Float[np.ndarray, " f"] | None

    def as_data(self) -> dict[str, object]:
        """Summary over the hidden frames; millimetres, litres, metres; None where there is nothing to say."""
        h = self.hidden
        out: dict[str, object] = {"hidden_frames": int(h.sum())}
        out["mean_volume_litres"] = round(float(self.volume[h].mean()) / LITRE, 4) if h.any() else None
        if self.error is not None and self.held is not None and self.square is not None:
            error, held = known(self.error[h]), known(self.held[h])
            square, seen = known(self.square[h]), known(self.error[~h])
            out["mean_error_hidden_mm"] = _mm(error.mean()) if error.size else None
            out["p95_error_hidden_mm"] = _mm(np.quantile(error, 0.95)) if error.size else None
            out["mean_error_seen_mm"] = _mm(seen.mean()) if seen.size else None
            out["mean_error_last_position_mm"] = _mm(held.mean()) if held.size else None
            out["hidden_inside_95"] = round(float((square <= QUANTILE_95).mean()), 4) if square.size else None
        if self.robot is not None and self.nearest is not None and self.robot.size:
            out["least_distance_to_robot_m"] = round(float(self.nearest.min()), 4)
            out["least_5_percent_distance_to_robot_m"] = round(float(self.robot.min()), 4)
        return out

    def sentences(self) -> list[str]:
        """The same in words; none where nothing was hidden."""
        data = self.as_data()
        lines = []
        if data["hidden_frames"]:
            lines.append(f"hidden in {data['hidden_frames']} frames, mean volume {data['mean_volume_litres']:.3g} l")
        if data.get("mean_error_hidden_mm") is not None:
            inside = 100.0 * float(data["hidden_inside_95"])  # type: ignore[arg-type]
            lines[-1] += (
                f"; error there {data['mean_error_hidden_mm']:.1f} mm (95 %: {data['p95_error_hidden_mm']:.1f}; last "
                f"position held: {data['mean_error_last_position_mm']:.1f}), truth inside the 95 % ellipsoid in "
                f"{inside:.0f} %"
            )
        if data.get("least_distance_to_robot_m") is not None:
            lines.append(f"nearest particle {data['least_distance_to_robot_m']:.3f} m from the robot")
        return lines


def known(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Those that are not NaN."""
    return values[~np.isnan(values)]


def _mm(metres: float | np.floating) -> float:
    return round(1000.0 * float(metres), 3)


def facts_of(
    track: WristTrack,
    state: Int[np.ndarray, " f"],
    seen: Float[np.ndarray, "f 3"],
    truth: Float[np.ndarray, "f 3"] | None,
    robot: RobotVolume | None = None,
) -> Facts:
    """Hold a track against what is known.

    Parameters
    ----------
    state : (f,)
        Of the wrist, from the sensor: 0 where it is tracked.
    seen : (f, 3)
        Where the sensor saw it, metres.
    truth : (f, 3) or None
        NaN where unknown.
    """
    tracked = (state == 0) & np.isfinite(seen).all(axis=1)
    hidden = ~tracked & (np.cumsum(tracked) > 0)
    error = held = square = None
    if truth is not None:
        error = np.linalg.norm(track.mean - truth, axis=1)
        held = np.linalg.norm(last_seen(seen, tracked) - truth, axis=1)
        square = squares(track, truth)
    quantile = nearest = None
    if robot is not None and robot.radius.shape[1] and track.cloud.shape[1]:
        apart = robot_distance(track.cloud, robot)
        quantile, nearest = np.quantile(apart, 0.05, axis=1), apart.min(axis=1)
    return Facts(hidden, track.volume, error, held, square, quantile, nearest)


def squares(track: WristTrack, truth: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, " f"]:
    """Squared Mahalanobis distance of the truth in every frame."""
    pairs = zip(truth, track.mean, track.covariance, strict=True)
    return np.array([mahalanobis(t[None], m, c)[0] if np.isfinite(t).all() else np.nan for t, m, c in pairs])


def last_seen(p: Float[np.ndarray, "f 3"], tracked: Bool[np.ndarray, " f"]) -> Float[np.ndarray, "f 3"]:
    """The last tracked position up to each frame; NaN before the first.

    >>> p = np.arange(9.0).reshape(3, 3)
    >>> last_seen(p, np.array([False, True, False]))[:, 0].tolist()
    [nan, 3.0, 3.0]
    """
    last = np.maximum.accumulate(np.where(tracked, np.arange(tracked.size), -1))
    return np.where(last[:, None] >= 0, p[np.maximum(last, 0)], np.nan)


def robot_distance(cloud: np.ndarray, robot: RobotVolume) -> Float[np.ndarray, "f c"]:
    """Distance of particles to the nearest pill of the robot, metres, below 0 inside; +inf without any pill."""
    out = np.full(cloud.shape[:2], np.inf)
    p = cloud.astype(float)
    for link in range(robot.radius.shape[1]):
        a, b = robot.ends[:, None, link, 0], robot.ends[:, None, link, 1]
        way = b - a
        length = np.maximum((way**2).sum(axis=-1), 1e-300)
        share = np.clip(((p - a) * way).sum(axis=-1) / length, 0.0, 1.0)
        apart = np.linalg.norm(p - a - share[..., None] * way, axis=-1) - robot.radius[:, None, link]
        out = np.minimum(out, apart)
    return out


def recovery(error: Float[np.ndarray, " f"], tracked: Bool[np.ndarray, " f"], near: float = RECOVERED) -> list[int]:
    """Frames from a wrist's coming back until the error is below `near`, for each time that it comes back.

    >>> recovery(np.array([0.0, 0.3, 0.2, 0.01]), np.array([True, False, True, True]))
    [2]
    """
    found = []
    for start in np.flatnonzero(tracked[1:] & ~tracked[:-1]) + 1:
        stop = start + int(np.argmin(np.append(tracked[start:], False)))
        good = np.flatnonzero(error[start:stop] <= near)
        found.append(int(good[0]) + 1 if good.size else int(stop - start) + 1)
    return found
