"""The compiled loop that turns colours into what a sensor delivers: gain, vignette, noise, rounding."""

import math

import numpy as np
from numba import njit

MIX = np.uint64(0x9E3779B97F4A7C15)
MIX1, MIX2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S30, S27, S31, S32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)
LOW32 = np.uint64(0xFFFFFFFF)


@njit(cache=True, error_model="numpy", inline="always")
def mixed(state):  # pragma: no cover - compiled
    """Sixty-four well mixed bits of a counter (SplitMix64: Steele, Lea, Flood, OOPSLA 2014)."""
    state = (state ^ (state >> S30)) * MIX1
    state = (state ^ (state >> S27)) * MIX2
    return state ^ (state >> S31)


@njit(cache=True, error_model="numpy")
def sensed(
    background, window, span, gain, vignette, across, noise, normals, key, line, out
):  # pragma: no cover - compiled
    """Grey levels of the whole image, spoilt by gain, vignette and noise, and rounded; twin: `synth.labels.plain`.

    Rows of `background` and `out` are (h, 3 w); the window's are put in at `span` = (x0, x1, y0, y1). `across` holds
    the squared distance of each value from the middle column over that of a corner. `normals` holds n standard normal
    numbers, and then its first 3 w again: a row's noise is the sum of two stretches of it that begin at random.
    """
    h, w = background.shape
    count = np.uint64(normals.size - w)
    middle = 0.5 * (h - 1)
    far = max(0.25 * (w / 3 - 1) * (w / 3 - 1) + middle * middle, 1e-300)
    scale, half = np.float32(noise * math.sqrt(0.5)), np.float32(0.5)
    fall = np.float32(gain * vignette)
    for v in range(h):
        for i in range(w):
            line[i] = np.float32(background[v, i])
        if span[2] <= v < span[3]:
            for i in range(3 * span[0], 3 * span[1]):
                line[i] = window[v - span[2], i - 3 * span[0]]
        if vignette != 0.0 or gain != 1.0:
            top = np.float32(gain * (1.0 - vignette * (v - middle) * (v - middle) / far))
            for i in range(w):
                line[i] *= top - fall * across[i]
        if noise != 0.0:
            bits = mixed(key + np.uint64(v + 1) * MIX)
            a, b = np.int64((bits & LOW32) % count), np.int64((bits >> S32) % count)
            for i in range(w):
                line[i] += scale * (normals[a + i] + normals[b + i])
        for i in range(w):
            level = np.int32(line[i] + half)
            out[v, i] = np.uint8(min(max(level, 0), 255))
