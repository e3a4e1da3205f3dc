"""The compiled loops between rays and pixels: the window's grid, triangles' boxes, optical flow."""

import math

from numba import njit

from .solids import NEAR, corner, triangle_hit, triangle_sides


@njit(cache=True, error_model="numpy", inline="always")
def bent(x, y, k):  # pragma: no cover - compiled
    """Distorted normalised coordinates; twin: `handtrack.camera.distort`."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@njit(cache=True, error_model="numpy", inline="always")
def straightened(bx, by, x, y, k):  # pragma: no cover - compiled
    """Inverse of `bent` by Newton's method from (x, y); twin: `handtrack.camera.undistort`."""
    for _ in range(20):
        px, py = bent(x, y, k)
        ex, ey = px - bx, py - by
        if abs(ex) + abs(ey) < 1e-14:
            break
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        growth = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * k[4] * r2))
        xx = radial + growth * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x
        yy = radial + growth * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x
        xy = growth * x * y + 2.0 * (k[2] * x + k[3] * y)
        whole = xx * yy - xy * xy
        x, y = x - (yy * ex - xy * ey) / whole, y - (xx * ey - xy * ex) / whole
    return x, y


@njit(cache=True, error_model="numpy")
def window_grid(lens, k, straight, x0, y0, grid):  # pragma: no cover - compiled
    """Normalised coordinates of the pixels from (x0, y0) on; twin: `synth.raycast.pixel_grid`."""
    fx, fy, cx, cy = lens
    for i in range(grid.shape[1]):
        y = (y0 + i - cy) / fy
        for j in range(grid.shape[2]):
            x = (x0 + j - cx) / fx
            if straight:
                grid[0, i, j], grid[1, i, j] = x, y
            elif j > 0:
                grid[0, i, j], grid[1, i, j] = straightened(x, y, grid[0, i, j - 1], grid[1, i, j - 1], k)
            else:
                start_x, start_y = (grid[0, i - 1, 0], grid[1, i - 1, 0]) if i > 0 else (x, y)
                grid[0, i, j], grid[1, i, j] = straightened(x, y, start_x, start_y, k)


@njit(cache=True, error_model="numpy")
def triangle_boxes(
    vertices, triangles, lens, k, straight, pinhole, view, bulge, size, boxes
):  # pragma: no cover - compiled
    """Pixel boxes (x0, x1, y0, y1), half open, that hold each triangle at every instant.

    `view` (x0, x1, y0, y1) bounds the normalised coordinates of the image. A corner outside it, where a distortion may
    fold, is moved to its border; `bulge` bounds the distortion's curvature there, pixels for a unit of squared length:
    an edge of length L leaves the chord of its ends by at most `bulge` L^2. A triangle that reaches behind a pinhole
    gets the whole image.
    """
    fx, fy, cx, cy = lens
    for t in range(triangles.shape[0]):
        low_x, high_x, low_y, high_y = math.inf, -math.inf, math.inf, -math.inf
        behind = 0
        for m in range(vertices.shape[0]):
            for c in range(3):
                x, y, z = corner(vertices, m, 0.0, triangles[t, c])
                if pinhole:
                    if z <= NEAR:
                        behind += 1
                        continue
                    x, y = x / z, y / z
                low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
        if behind == 3 * vertices.shape[0]:
            boxes[t] = 0
            continue
        if behind > 0:
            boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3] = 0, size[0], 0, size[1]
            continue
        if low_x > view[1] or high_x < view[0] or low_y > view[3] or high_y < view[2]:
            boxes[t] = 0
            continue
        spare = 0.0
        if not straight:
            low_x, high_x = max(low_x, view[0]), min(high_x, view[1])
            low_y, high_y = max(low_y, view[2]), min(high_y, view[3])
            reach = (high_x - low_x) * (high_x - low_x) + (high_y - low_y) * (high_y - low_y)
            spare = bulge * reach
            x0, x1, y0, y1 = math.inf, -math.inf, math.inf, -math.inf
            for c in range(4):  # the corners of the box bound its image, but for the bulge of its edges
                x, y = bent(low_x if c & 1 else high_x, low_y if c & 2 else high_y, k)
                x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
            low_x, high_x, low_y, high_y = x0, x1, y0, y1
        boxes[t, 0] = min(max(int(math.floor(low_x * fx + cx - spare)), 0), size[0])
        boxes[t, 1] = min(max(int(math.ceil(high_x * fx + cx + spare)) + 1, 0), size[0])
        boxes[t, 2] = min(max(int(math.floor(low_y * fy + cy - spare)), 0), size[1])
        boxes[t, 3] = min(max(int(math.ceil(high_y * fy + cy + spare)) + 1, 0), size[1])


@njit(cache=True, error_model="numpy")
def flow(
    grid, lens, k, straight, corner_xy, pinhole, tables, frames, next_frames, vertices, next_vertices, triangles, knot,
    blend, depth, surface, out,
):  # pragma: no cover - compiled  # fmt: skip
    """Pixels by which every surface point moves until the next frame; twin: `synth.labels.plain.flow`."""
    fx, fy, cx, cy = lens
    count, step = tables
    for v in range(surface.shape[0]):
        for u in range(surface.shape[1]):
            s = surface[v, u]
            if s < 0:
                continue
            x, y, z = grid[0, v + 1, u + 1], grid[1, v + 1, u + 1], depth[v, u]
            if s < count:
                if pinhole:
                    x, y = x * z, y * z
                i = s + step * v
                x, y, z = x - frames[i, 0], y - frames[i, 1], z - frames[i, 2]
                a, b, c = (
                    frames[i, 3] * x + frames[i, 4] * y + frames[i, 5] * z,
                    frames[i, 6] * x + frames[i, 7] * y + frames[i, 8] * z,
                    frames[i, 9] * x + frames[i, 10] * y + frames[i, 11] * z,
                )
                x = next_frames[i, 0] + next_frames[i, 3] * a + next_frames[i, 6] * b + next_frames[i, 9] * c
                y = next_frames[i, 1] + next_frames[i, 4] * a + next_frames[i, 7] * b + next_frames[i, 10] * c
                z = next_frames[i, 2] + next_frames[i, 5] * a + next_frames[i, 8] * b + next_frames[i, 11] * c
            else:
                t = s - count
                sides = triangle_sides(vertices, triangles, knot[v], blend[v], pinhole, t)
                shares = triangle_hit(x, y, pinhole, sides)
                x, y, z = 0.0, 0.0, 0.0
                for c in range(3):
                    px, py, pz = corner(next_vertices, knot[v], blend[v], triangles[t, c])
                    x, y, z = x + shares[1 + c] * px, y + shares[1 + c] * py, z + shares[1 + c] * pz
            if pinhole:
                if z <= NEAR:
                    out[v, u, 0], out[v, u, 1] = math.nan, math.nan
                    continue
                x, y = x / z, y / z
                if not straight:
                    x, y = bent(x, y, k)
            out[v, u, 0] = x * fx + cx - (corner_xy[0] + u)
            out[v, u, 1] = y * fy + cy - (corner_xy[1] + v)
