"""Compiled loops over skinned vertices: posing them, and residual rows of edge points against points of the skin."""

import math

from numba import njit


@njit(cache=True)
def pose_skin(frames, bone_frame, bone, weight, local, local_normal, R, t, p, normal):  # pragma: no cover - compiled
    """Posed vertices and unit normals in camera axes by linear blend skinning; twin: `surface.skin.posed_numpy`."""
    for v in range(weight.shape[0]):
        x = y = z = nx = ny = nz = 0.0
        for i in range(weight.shape[1]):
            w = weight[v, i]
            if w == 0.0:
                continue
            f = bone_frame[bone[v, i]]
            a, b, c = local[v, i, 0], local[v, i, 1], local[v, i, 2]
            k, m, n = local_normal[v, i, 0], local_normal[v, i, 1], local_normal[v, i, 2]
            if f < 0:
                x, y, z = x + w * a, y + w * b, z + w * c
                nx, ny, nz = nx + w * k, ny + w * m, nz + w * n
                continue
            F = frames[f]
            x += w * (F[0, 0] * a + F[0, 1] * b + F[0, 2] * c + F[0, 3])
            y += w * (F[1, 0] * a + F[1, 1] * b + F[1, 2] * c + F[1, 3])
            z += w * (F[2, 0] * a + F[2, 1] * b + F[2, 2] * c + F[2, 3])
            nx += w * (F[0, 0] * k + F[0, 1] * m + F[0, 2] * n)
            ny += w * (F[1, 0] * k + F[1, 1] * m + F[1, 2] * n)
            nz += w * (F[2, 0] * k + F[2, 1] * m + F[2, 2] * n)
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / size if size > 0.0 else 0.0
        for i in range(3):
            p[v, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + t[i]
            normal[v, i] = scale * (R[i, 0] * nx + R[i, 1] * ny + R[i, 2] * nz)


@njit(cache=True)
def skin_motion(frames, bone_frame, bone, weight, local, moves, joint_frame, prismatic, v, share, p, J):
    # pragma: no cover - compiled
    """Add `share` times a posed vertex to p (3,), and its derivative by all joints to J (3, j), world axes."""
    for i in range(weight.shape[1]):
        w = weight[v, i] * share
        if w == 0.0:
            continue
        f = bone_frame[bone[v, i]]
        a, b, c = local[v, i, 0], local[v, i, 1], local[v, i, 2]
        if f < 0:
            p[0], p[1], p[2] = p[0] + w * a, p[1] + w * b, p[2] + w * c
            continue
        F = frames[f]
        x = F[0, 0] * a + F[0, 1] * b + F[0, 2] * c + F[0, 3]
        y = F[1, 0] * a + F[1, 1] * b + F[1, 2] * c + F[1, 3]
        z = F[2, 0] * a + F[2, 1] * b + F[2, 2] * c + F[2, 3]
        p[0], p[1], p[2] = p[0] + w * x, p[1] + w * y, p[2] + w * z
        for j in range(J.shape[1]):
            if not moves[f, j]:
                continue
            g = joint_frame[j]
            zx, zy, zz = frames[g, 0, 2], frames[g, 1, 2], frames[g, 2, 2]
            if prismatic[g]:
                J[0, j], J[1, j], J[2, j] = J[0, j] + w * zx, J[1, j] + w * zy, J[2, j] + w * zz
                continue
            px, py, pz = x - frames[g, 0, 3], y - frames[g, 1, 3], z - frames[g, 2, 3]
            J[0, j] += w * (zy * pz - zz * py)
            J[1, j] += w * (zz * px - zx * pz)
            J[2, j] += w * (zx * py - zy * px)


@njit(cache=True)
def contact_points(
    frames, bone_frame, bone, weight, local, moves, joint_frame, prismatic, vertex, share, p, J
):  # pragma: no cover - compiled
    """Points on mesh edges and their derivatives by all joints, world axes; twin: `surface.skin.points_numpy`.

    Point i lies at `share[i]` between vertices `vertex[i, 0]` and `vertex[i, 1]`.
    """
    for i in range(vertex.shape[0]):
        p[i] = 0.0
        J[i] = 0.0
        for side in range(2):
            part = share[i] if side else 1.0 - share[i]
            skin_motion(
                frames,
                bone_frame,
                bone,
                weight,
                local,
                moves,
                joint_frame,
                prismatic,
                vertex[i, side],
                part,
                p[i],
                J[i],
            )


@njit(cache=True)
def normal_motion(
    frames, bone_frame, bone, weight, local_normal, moves, joint_frame, prismatic, vertex, normal, J
):  # pragma: no cover - compiled
    """Blended unit normals of vertices, derivatives by all joints, world axes; twin: `surface.skin.normals_numpy`.

    A joint turns the part of each bone it moves, `dn = sum w z x (R n_local)`; unit length takes off what is along n.
    """
    for i in range(vertex.shape[0]):
        v = vertex[i]
        x = y = z = 0.0
        J[i] = 0.0
        for b in range(weight.shape[1]):
            w = weight[v, b]
            if w == 0.0:
                continue
            f = bone_frame[bone[v, b]]
            a, c, d = w * local_normal[v, b, 0], w * local_normal[v, b, 1], w * local_normal[v, b, 2]
            if f < 0:
                x, y, z = x + a, y + c, z + d
                continue
            F = frames[f]
            px = F[0, 0] * a + F[0, 1] * c + F[0, 2] * d
            py = F[1, 0] * a + F[1, 1] * c + F[1, 2] * d
            pz = F[2, 0] * a + F[2, 1] * c + F[2, 2] * d
            x, y, z = x + px, y + py, z + pz
            for j in range(J.shape[2]):
                g = joint_frame[j]
                if not moves[f, j] or prismatic[g]:
                    continue
                zx, zy, zz = frames[g, 0, 2], frames[g, 1, 2], frames[g, 2, 2]
                J[i, 0, j] += zy * pz - zz * py
                J[i, 1, j] += zz * px - zx * pz
                J[i, 2, j] += zx * py - zy * px
        size = math.sqrt(x * x + y * y + z * z)
        scale = 1.0 / size if size > 0.0 else 0.0
        x, y, z = x * scale, y * scale, z * scale
        normal[i, 0], normal[i, 1], normal[i, 2] = x, y, z
        for j in range(J.shape[2]):
            along = x * J[i, 0, j] + y * J[i, 1, j] + z * J[i, 2, j]
            J[i, 0, j] = scale * (J[i, 0, j] - along * x)
            J[i, 1, j] = scale * (J[i, 1, j] - along * y)
            J[i, 2, j] = scale * (J[i, 2, j] - along * z)
