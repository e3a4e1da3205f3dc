"""A track of a walk, and where known the raw suit and the truth, in; figures and sentences of its page out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from ..body.walk_metrics import WalkErrors, held, walk_errors
from ..formats.walk_tracks import STATUSES, WalkTrack
from ..formats.walks import WalkTruth


@dataclass(frozen=True, slots=True, eq=False)
class WalkFacts:
    """Figures of a run.

    Attributes
    ----------
    in_view : float
        Share of the frames in which the camera saw the person.
    longest : float
        Seconds of the longest stretch in which it did not.
    shares : tuple of float
        Of the frames, for each of `formats.walk_tracks.STATUSES`.
    errors, raw : WalkErrors or None
        Of the track, and of the suit alone.
    held, heading_held : float
        Share of the places (along each axis) and of the headings that two sigma hold; NaN without truth.
    out_of_view : (f,) bool
        Frames in which the camera saw nobody.
    """

    in_view: float
    longest: float
    shares: tuple[float, ...]
    errors: WalkErrors | None
    raw: WalkErrors | None
    held: float
    heading_held: float
    out_of_view: Bool[np.ndarray, " f"]

    def as_data(self) -> dict[str, object]:
        """The same as plain data, millimetres and degrees; None where there is nothing to say."""
        out: dict[str, object] = {
            "in_view": _round(self.in_view),
            "longest_out_of_view_s": _round(self.longest),
            **{name: _round(share) for name, share in zip(STATUSES, self.shares, strict=True)},
        }
        if self.errors is None:
            return out
        for before, errors in (("", self.errors), ("raw_", self.raw)):
            if errors is not None:
                out |= {
                    f"{before}mean_error_mm": _mm(errors.place),
                    f"{before}out_of_view_error_mm": _mm(errors.place[self.out_of_view]),
                    f"{before}wrists_error_mm": _mm(errors.wrist),
                    f"{before}heading_error_deg": _round(float(np.degrees(_mean(np.abs(errors.heading)))), 3),
                }
        return out | {"place_in_two_sigma": _round(self.held), "heading_in_two_sigma": _round(self.heading_held)}

    def sentences(self) -> list[str]:
        """The same in words."""
        lines = [f"in view in {100.0 * self.in_view:.0f} % of the frames, out of view for {self.longest:.1f} s at most"]
        data = self.as_data()
        if self.errors is None or data["mean_error_mm"] is None:
            return lines
        raw = "" if data.get("raw_mean_error_mm") is None else f" (suit alone {data['raw_mean_error_mm']:.0f})"
        blind = "" if data["out_of_view_error_mm"] is None else f", out of view {data['out_of_view_error_mm']:.0f} mm"
        lines.append(
            f"mean error of the pelvis {data['mean_error_mm']:.0f} mm{raw}{blind}, of the heading "
            f"{data['heading_error_deg']:.2f} degrees; two sigma hold {100.0 * self.held:.0f} % of the places"
        )
        return lines


def walk_facts(track: WalkTrack, raw: WalkTrack | None = None, truth: WalkTruth | None = None) -> WalkFacts:
    """Figures of a track, held against the truth where there is one.

    Parameters
    ----------
    raw : WalkTrack or None
        The suit alone, at the same frames.
    truth : WalkTruth or None
        At the same frames.

    Raises
    ------
    ValueError
        If `raw` or `truth` is not of the track's frames.
    """
    f = track.frame.size
    for name, count in (("raw", f if raw is None else raw.frame.size), ("truth", f if truth is None else len(truth.p))):
        if count != f:
            raise ValueError(f"{name}: has {count} frames, wanted those of the track, {f}")
    blind = ~track.in_view
    errors = None if truth is None else walk_errors(track, truth)
    places = headings = np.nan
    if errors is not None:
        places = float(held(errors.off, track.sigma).mean())
        headings = float(held(errors.heading[:, None], track.sigma_heading[:, None])[0])
    return WalkFacts(
        in_view=float(track.in_view.mean()) if f else 0.0,
        longest=max((float(track.time[b] - track.time[a]) for a, b in spans(blind)), default=0.0),
        shares=tuple(float(np.mean(track.status == name)) if f else 0.0 for name in STATUSES),
        errors=errors,
        raw=None if raw is None or truth is None else walk_errors(raw, truth),
        held=places,
        heading_held=headings,
        out_of_view=blind,
    )


def spans(on: Bool[np.ndarray, " f"]) -> list[tuple[int, int]]:
    """First and last index of every stretch that is on.

    >>> spans(np.array([False, True, True, False, True]))
    [(1, 2), (4, 4)]
    """
    edge: Int[np.ndarray, " g"] = np.diff(np.concatenate([[0], on.astype(int), [0]]))
    return list(zip(np.flatnonzero(edge == 1).tolist(), (np.flatnonzero(edge == -1) - 1).tolist(), strict=True))


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _mm(values: np.ndarray) -> float | None:
    return _round(1000.0 * _mean(values), 2)


def _round(value: float, digits: int = 4) -> float | None:
    return round(value, digits) if np.isfinite(value) else None
