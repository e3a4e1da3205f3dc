"""The compiled loop that finds normals and own places of surface points; twin: `synth.labels.plain.places`.

A surface point of a pill is known by its place in the pill's own frame, one of a triangle by its place on the unbent
hand or occluder (`rest`): textures are solid there and move with the skin. `frames` holds each pill's base and the rows
of its axes, in the order of the table of pills.
"""

import math

from numba import njit

from .solids import triangle_hit, triangle_sides


@njit(cache=True, error_model="numpy")
def places(
    count, v, x, y, t, surface, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, out
):  # pragma: no cover - compiled
    """Unit normals and own places of `count` hits in row v of the window, into the six rows of `out`."""
    pill_places(count, v, x, y, t, surface, pinhole, tables, pills, frames, out)
    first, m, share = tables[0], knot[v], blend[v]
    at = min(m, normals.shape[0] - 1)
    for i in range(count):
        k = surface[i] - first
        if k < 0:
            continue
        sides = triangle_sides(vertices, triangles, m, share, pinhole, k)
        _, a, b, c = triangle_hit(x[i], y[i], pinhole, sides)
        i0, i1, i2 = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        n0 = a * normals[at, i0, 0] + b * normals[at, i1, 0] + c * normals[at, i2, 0]
        n1 = a * normals[at, i0, 1] + b * normals[at, i1, 1] + c * normals[at, i2, 1]
        n2 = a * normals[at, i0, 2] + b * normals[at, i1, 2] + c * normals[at, i2, 2]
        size = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        size = 1.0 / size if size > 0.0 else 0.0
        out[0, i], out[1, i], out[2, i] = n0 * size, n1 * size, n2 * size
        out[3, i] = a * rest[i0, 0] + b * rest[i1, 0] + c * rest[i2, 0]
        out[4, i] = a * rest[i0, 1] + b * rest[i1, 1] + c * rest[i2, 1]
        out[5, i] = a * rest[i0, 2] + b * rest[i1, 2] + c * rest[i2, 2]


@njit(cache=True, error_model="numpy")
def pill_places(count, v, x, y, t, surface, pinhole, tables, pills, frames, out):  # pragma: no cover - compiled
    """The same for the hits on pills; the normals' derivation: `synth.raycast.pill_normal`."""
    for i in range(count):
        k = surface[i]
        if k >= tables[0]:
            continue
        k += v * tables[1]
        px, py = (x[i] * t[i], y[i] * t[i]) if pinhole else (x[i], y[i])
        px, py, pz = px - pills[k, 0], py - pills[k, 1], t[i] - pills[k, 2]
        ux, uy, uz = pills[k, 3], pills[k, 4], pills[k, 5]
        r0, slope = pills[k, 7], pills[k, 9]
        along = (px * ux + py * uy + pz * uz - r0 * slope) / pills[k, 10]
        along = along if along > 0.0 else 0.0
        along = along if along < pills[k, 6] else pills[k, 6]
        scale = 1.0 / (r0 - slope * along)
        out[0, i], out[1, i], out[2, i] = (
            (px - along * ux) * scale,
            (py - along * uy) * scale,
            (pz - along * uz) * scale,
        )
        px, py, pz = px + pills[k, 0] - frames[k, 0], py + pills[k, 1] - frames[k, 1], pz + pills[k, 2] - frames[k, 2]
        out[3, i] = px * frames[k, 3] + py * frames[k, 4] + pz * frames[k, 5]
        out[4, i] = px * frames[k, 6] + py * frames[k, 7] + pz * frames[k, 8]
        out[5, i] = px * frames[k, 9] + py * frames[k, 10] + pz * frames[k, 11]
