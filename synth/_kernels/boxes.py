"""The compiled loop over points and turned boxes."""

import math

from numba import njit


@njit(cache=True, error_model="numpy")
def box_distance(p, centre, half, cosine, sine, out):  # pragma: no cover - compiled
    """Distance of points from the nearest box, negative inside; twin: `synth.cell_room.distance_to_numpy`."""
    for i in range(p.shape[0]):
        best = math.inf
        for b in range(centre.shape[0]):
            x, y = p[i, 0] - centre[b, 0], p[i, 1] - centre[b, 1]
            qx = abs(cosine[b] * x + sine[b] * y) - half[b, 0]
            qy = abs(cosine[b] * y - sine[b] * x) - half[b, 1]
            qz = abs(p[i, 2] - centre[b, 2]) - half[b, 2]
            ox, oy, oz = max(qx, 0.0), max(qy, 0.0), max(qz, 0.0)
            best = min(best, math.sqrt(ox * ox + oy * oy + oz * oz) + min(max(qx, qy, qz), 0.0))
        out[i] = best
