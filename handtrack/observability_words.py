"""Open directions in, the words and plain data that name them out: for the report, `run.json` and a reader.

thumb_abduction 0.78, thumb_palmar -0.54: the view cannot tell them apart; sigma 25 deg, frames 10-40
"""

import numpy as np
from jaxtyping import Float

from .observability import UNKNOWN, Observability

_SAID = 0.25  # share of the largest weight from which on a joint is named
_BEYOND = 0.9  # share of UNKNOWN beyond which a sigma is only said to be larger


def named(seen: Observability, direction: Float[np.ndarray, " k"]) -> tuple[tuple[str, float], ...]:
    """Joints of a direction with their signed weights, the largest first; small ones left out."""
    order = np.argsort(-np.abs(direction), kind="stable")
    kept = [i for i in order if abs(direction[i]) > _SAID * abs(direction[order[0]])]
    return tuple((seen.joint_names[seen.free[i]], round(float(direction[i]), 2)) for i in kept)


def lines(seen: Observability) -> tuple[str, ...]:
    """The findings as sentences, the longest-lasting first; one line if the images fix everything."""
    limit = f"{np.degrees(seen.threshold):.0f} degrees"
    if not seen.count.size:
        what = _weights(named(seen, seen.weakest))
        sigma = _sigma(seen, seen.weakest, seen.weakest_sigma)
        always = "in every frame" if seen.weakest_sigma <= seen.threshold else "but for single frames"
        return (
            f"The images alone fix every joint to better than {limit} {always}; "
            f"the weakest direction is {what} (sigma {sigma}, frame {seen.weakest_frame}).",
        )
    texts = []
    for same in grouped(seen):
        i = same[0]
        when = span(int(seen.first[i]), int(seen.last[i]))
        sigma = _sigma(seen, seen.direction[i], float(seen.direction_sigma[i]))
        if seen.unseen[i]:
            texts.append(f"{unseen_names(seen, same)}: not seen; sigma {sigma}, {when}")
        else:
            weights = named(seen, seen.direction[i])
            told = "the view hardly shows it" if len(weights) == 1 else "the view cannot tell them apart"
            texts.append(f"{_weights(weights)}: {told}; sigma {sigma}, {when}")
    return tuple(texts)


def span(first: int, last: int) -> str:
    """A stretch of frames in words.

    >>> span(3, 9), span(4, 4)
    ('frames 3-9', 'frame 4')
    """
    return f"frames {first}-{last}" if last > first else f"frame {first}"


def grouped(seen: Observability) -> list[tuple[int, ...]]:
    """Rows of the findings, the longest-lasting first; joints not seen in the same frames together."""
    said: set[int] = set()
    groups = []
    for i in np.argsort(-seen.count * seen.largest_sigma, kind="stable").tolist():
        if i in said:
            continue
        same = seen.unseen & (seen.first == seen.first[i]) & (seen.last == seen.last[i])
        group = tuple(np.flatnonzero(same).tolist()) if seen.unseen[i] else (i,)
        said |= set(group)
        groups.append(group)
    return groups


def unseen_names(seen: Observability, group: tuple[int, ...]) -> str:
    """Names of a group of unseen joints."""
    if len(group) == seen.free.size > 1:
        return "every joint"
    return ", ".join(named(seen, seen.direction[j])[0][0] for j in group)


def as_data(seen: Observability) -> dict[str, object]:
    """The findings as plain data for JSON; angles in degrees, sliding joints in model units."""
    scale = np.where(seen.prismatic, 1.0, 180.0 / np.pi)
    median = np.median(seen.sigma, axis=0) * scale
    found = [
        {
            "joints": dict(named(seen, seen.direction[i])),
            "sigma": round(_size(seen, seen.direction[i], float(seen.direction_sigma[i])), 2),
            "largest_sigma": round(_size(seen, seen.direction[i], float(seen.largest_sigma[i])), 2),
            "unit": _unit(seen, seen.direction[i]),
            "first": int(seen.first[i]),
            "last": int(seen.last[i]),
            "frames": int(seen.count[i]),
            "unseen": bool(seen.unseen[i]),
        }
        for i in range(seen.count.size)
    ]
    return {
        "threshold": round(float(np.degrees(seen.threshold)), 3),
        "text": list(lines(seen)),
        "directions": found,
        "weakest": {
            "joints": dict(named(seen, seen.weakest)),
            "sigma": round(_size(seen, seen.weakest, seen.weakest_sigma), 3),
            "unit": _unit(seen, seen.weakest),
            "frame": seen.weakest_frame,
        },
        "median_sigma": {name: round(float(value), 4) for name, value in zip(seen.joint_names, median, strict=True)},
    }


def _weights(weights: tuple[tuple[str, float], ...]) -> str:
    return weights[0][0] if len(weights) == 1 else ", ".join(f"{name} {value:.2g}" for name, value in weights)


def _leads_sliding(seen: Observability, direction: Float[np.ndarray, " k"]) -> bool:
    return bool(seen.prismatic[seen.free[int(np.argmax(np.abs(direction)))]])


def _unit(seen: Observability, direction: Float[np.ndarray, " k"]) -> str:
    return seen.units if _leads_sliding(seen, direction) else "deg"


def _size(seen: Observability, direction: Float[np.ndarray, " k"], sigma: float) -> float:
    return sigma * (seen.length if _leads_sliding(seen, direction) else 180.0 / np.pi)


def _sigma(seen: Observability, direction: Float[np.ndarray, " k"], sigma: float) -> str:
    beyond = sigma > _BEYOND * UNKNOWN
    size = _size(seen, direction, _BEYOND * UNKNOWN if beyond else sigma)
    return f"{'over ' if beyond else ''}{size:.{0 if size >= 9.95 else 1}f} {_unit(seen, direction)}"
