"""Compiled judgement of skeletons: sides, centre joints, heights and rewards of all people of a frame in one call."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def _length(p, a, b):  # pragma: no cover - compiled
    return math.sqrt((p[a, 0] - p[b, 0]) ** 2 + (p[a, 1] - p[b, 1]) ** 2 + (p[a, 2] - p[b, 2]) ** 2)


@njit(cache=True)
def _height(p, confidence, near, far, share, shortest, tallest, told):  # pragma: no cover - compiled
    """Median of the plausible heights that bones tell; NaN for none."""
    count = 0
    for b in range(share.size):
        if confidence[near[b]] > 0.0 and confidence[far[b]] > 0.0:
            h = _length(p, near[b], far[b]) / share[b]
            if shortest < h < tallest:
                told[count] = h
                count += 1
    if count == 0:
        return np.nan
    ranked = np.sort(told[:count])
    return 0.5 * (ranked[(count - 1) // 2] + ranked[count // 2])


@njit(cache=True)
def _misfit(p, a, b, expected):  # pragma: no cover - compiled
    return min(abs(_length(p, a, b) - expected) / expected, 1.0) if not math.isnan(p[a, 0] + p[b, 0]) else math.nan


@njit(cache=True)
def _sides(p, confidence, height, pairs, shares, clear):  # pragma: no cover - compiled
    """Change left and right back where that makes bones as long as they should be."""
    for i in range(shares.size):
        near, far = pairs[i, 0], pairs[i, 1]
        expected = height * shares[i]
        across = _misfit(p, near, far + 1, expected) + _misfit(p, near + 1, far, expected)
        straight = _misfit(p, near, far, expected) + _misfit(p, near + 1, far + 1, expected)
        if across + 2.0 * clear < straight:
            for d in range(3):
                p[far, d], p[far + 1, d] = p[far + 1, d], p[far, d]
            confidence[far], confidence[far + 1] = confidence[far + 1], confidence[far]


@njit(cache=True)
def _between(p, confidence, k, a, b, share):  # pragma: no cover - compiled
    """Put keypoint k, if it is not seen, at a + share (b - a)."""
    if not math.isnan(p[k, 0]) or math.isnan(p[a, 0] + p[b, 0]):
        return
    for d in range(3):
        p[k, d] = p[a, d] + share * (p[b, d] - p[a, d])
    confidence[k] = min(confidence[a], confidence[b])


@njit(cache=True)
def judge_skeletons(
    p, confidence, near, far, share, pairs, shares, known, numbers, height, added, bones
):  # pragma: no cover - compiled
    """Judge skeletons in place; twin: `body.spatial.judged_numpy`.

    p (m, 16, 3) metres, NaN unseen, and confidence (m, 16), 0 there, get their sides right and centre joints; near,
    far, share (b,) bones; pairs (4, 2), shares (4,) limbs whose sides can be changed; known (m,) heights, NaN for
    none; numbers: shortest and tallest height, how clear a change must be, tolerance, reward, penalty, share of the
    head beyond the shoulders. Fills height (m,), added (m, 16) and bones (m,).
    """
    told = np.empty(share.size)
    for i in range(p.shape[0]):
        q, c = p[i], confidence[i]
        first = _height(q, c, near, far, share, numbers[0], numbers[1], told)
        _sides(q, c, first, pairs, shares, numbers[2])
        _between(q, c, 13, 6, 7, 0.5)
        _between(q, c, 14, 0, 1, 0.5)
        _between(q, c, 12, 13, 14, 0.5)
        _between(q, c, 15, 14, 13, -numbers[6])
        h = known[i]
        if not math.isfinite(h):
            h = _height(q, c, near, far, share, numbers[0], numbers[1], told)
        height[i] = h
        good, bad = np.zeros(16, np.int64), np.zeros(16, np.int64)
        bones[i] = 0.0
        for b in range(share.size):
            long = _length(q, near[b], far[b])
            if math.isnan(long):
                continue
            bones[i] += 1.0
            if math.isnan(h):
                continue
            right = abs(long - h * share[b]) <= numbers[3] * h * share[b]
            for k in (near[b], far[b]):
                if right:
                    good[k] += 1
                else:
                    bad[k] += 1
        for k in range(16):
            if good[k] > 1 and bad[k] == 0:
                added[i, k] = 2.0 * numbers[4]
            elif bad[k] > 1:
                added[i, k] = -2.0 * numbers[5]
            else:
                added[i, k] = numbers[4] * (good[k] > 0) - numbers[5] * (bad[k] > 0)
