"""Solids, camera and paint in, colour, depth and parts out through OpenGL: the twin of `synth.labels`.

Pyrender rasterises triangles into a Z-buffer, without a screen, through EGL (any driver, Mesa's software one too) or
OSMesa. Pills become triangles whose distance from the true surface is bounded, so depth and parts agree with the exact
renderer but for borders. Three kinds of shading: `flat`, our light at the middle of each triangle; `gouraud`, our
light at the vertices, blended between them; `smooth`, pyrender's own lights at every pixel, which follow other laws
than ours.

Pyrender is the extra `[gl]`, and nothing else here needs it. Version 0.1.45 asks NumPy for a name that NumPy 2 has
given up; it gets it back before pyrender is loaded. OpenGL's platform is chosen when it is loaded first and stays.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType, TracebackType
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int, UInt8

from handtrack.camera import Camera
from handtrack.errors import InputError

from .labels import plain
from .labels.image import lattice, light_table, paint_table
from .labels.solids import Lights, Paint, Solids
from .raycast import pill_table

Shading = Literal["flat", "gouraud", "smooth"]
Platform = Literal["egl", "osmesa"]
TOLERANCE = 0.05  # mm by which triangles may lie inside the pills they stand for
_TO_GL = np.diag([1.0, -1.0, -1.0])  # OpenGL's cameras look along -z with y up
_OTHER: dict[Platform, Platform] = {"egl": "osmesa", "osmesa": "egl"}


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Surfaces as triangles in camera axes, each vertex with what its light depends on.

    Attributes
    ----------
    vertices, normals : (v, 3), (v, 3)
    own : (v, 3)
        Places in the surfaces' own frames, for textures.
    triangles, part : (t, 3), (t,)
    """

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    own: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    part: Int[np.ndarray, " t"]


@dataclass(frozen=True, slots=True, eq=False)
class GlImage:
    """What OpenGL drew: colour, depth (camera z in mm, inf where nothing is), part (-1 where nothing is)."""

    colour: UInt8[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    part: Int[np.ndarray, "h w"]


def pill_triangles(
    row: Float[np.ndarray, " p"], tolerance: float = TOLERANCE
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Vertices and normals (x along the axis from the base), and triangles, of a pill given as a row of `pill_table`.

    All vertices lie on the pill. The profile is a half circle about the base up to where the cone touches it, and one
    about the tip from there on; the number of corners around keeps chords within `tolerance` of their arcs.
    """
    length, r0, r1, slope = row[6:10]
    largest = max(r0, r1)
    step = 2.0 * np.arccos(1.0 - min(tolerance, 0.5 * largest) / largest)
    around = max(8, int(np.ceil(2.0 * np.pi / step)))
    contact = np.arccos(np.clip(slope, -1.0, 1.0))
    base = np.linspace(np.pi, contact, max(3, int(np.ceil((np.pi - contact) / step)) + 1))
    tip = np.linspace(contact, 0.0, max(3, int(np.ceil(contact / step)) + 1))
    angle = np.concatenate([base, tip])
    radius = np.concatenate([np.full(base.size, r0), np.full(tip.size, r1)])
    start = np.concatenate([np.zeros(base.size), np.full(tip.size, length)])
    turn = 2.0 * np.pi * np.arange(around) / around
    normal = np.stack(
        [
            np.repeat(np.cos(angle)[:, None], around, axis=1),
            np.sin(angle)[:, None] * np.cos(turn),
            np.sin(angle)[:, None] * np.sin(turn),
        ],
        axis=-1,
    )
    place = radius[:, None, None] * normal
    place[..., 0] += start[:, None]
    i, j = np.meshgrid(np.arange(angle.size - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = a + around, b + around
    faces = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).reshape(-1, 3)
    return place.reshape(-1, 3), normal.reshape(-1, 3), faces


def as_triangles(solids: Solids, tolerance: float = TOLERANCE) -> Triangles:
    """All surfaces as triangles; those of pills at most `tolerance` mm inside the true ones."""
    vertices, normals, own = [solids.vertices], [solids.normals], [solids.rest]
    triangles, parts, first = [solids.triangles], [solids.triangle_part], solids.vertices.shape[0]
    for k, row in enumerate(pill_table(solids.pills)):
        place, normal, faces = pill_triangles(row, tolerance)
        axes = _across(row[3:6])
        at = place @ axes + row[:3]
        vertices.append(at)
        normals.append(normal @ axes)
        own.append((at - solids.pills.base[k]) @ solids.pill_axes[k].T)
        triangles.append(faces + first)
        parts.append(np.full(faces.shape[0], solids.pill_part[k]))
        first += place.shape[0]
    return Triangles(*(np.concatenate(each) for each in (vertices, normals, own, triangles, parts)))


def _across(axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Right-handed axes as rows, the first one given."""
    y = np.eye(3)[int(np.abs(axis).argmin())]
    y = y - (y @ axis) * axis
    y = y / np.linalg.norm(y)
    return np.stack([axis, y, np.cross(axis, y)])


def vertex_colours(
    shapes: Triangles, part: Int[np.ndarray, " v"], camera: Camera, paint: Paint, lights: Lights
) -> Float[np.ndarray, "v 3"]:
    """Our light at every vertex, 0..255."""
    pinhole = camera.kind == "perspective"
    xy = shapes.vertices[:, :2] / shapes.vertices[:, 2:] if pinhole else shapes.vertices[:, :2]
    placed = np.concatenate([shapes.normals.T, shapes.own.T])
    table = paint_table(paint)[part]
    return plain.lit(placed, xy, pinhole, table, light_table(lights), lights.ambient, lattice())


class Twin:
    """An offscreen OpenGL renderer of one image size; a context manager, as it holds a driver's resources.

    Parameters
    ----------
    width, height : int
    platform : {"egl", "osmesa"}
        Tried first; the other one if it cannot be loaded. The one that is loaded first in a process stays.

    Raises
    ------
    InputError
        If pyrender is not installed, or neither platform works.
    """

    def __init__(self, width: int, height: int, platform: Platform = "egl") -> None:
        self._pyrender, works = load(platform)
        with _chosen(works):
            self._renderer = self._pyrender.OffscreenRenderer(width, height)
        self._size = (width, height)

    def __enter__(self) -> "Twin":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the driver's resources back."""
        self._renderer.delete()

    def render(
        self,
        shapes: Triangles,
        camera: Camera,
        paint: Paint,
        lights: Lights,
        shading: Shading = "gouraud",
        background: tuple[int, int, int] = (0, 0, 0),
    ) -> GlImage:
        """Draw surfaces, from `as_triangles`.

        Raises
        ------
        ValueError
            For a camera of another size, or with distortion.
        """
        if (camera.width, camera.height) != self._size:
            raise ValueError(f"camera: {camera.width}x{camera.height} pixels; wanted {self._size[0]}x{self._size[1]}")
        if camera.distortion.any():
            raise ValueError("camera: has distortion; OpenGL draws straight lines straight, so none is wanted")
        scene = self._scene(shapes, camera, paint, lights, shading, background)
        return self._drawn(scene, shading)

    def redrawing(
        self, shapes: Triangles, camera: Camera, paint: Paint, lights: Lights, stiff: bool = True
    ) -> Callable[[], GlImage]:
        """A function that draws the same again: for timing. Unless `stiff`, all vertices are sent anew each time."""
        scene = self._scene(shapes, camera, paint, lights, "gouraud", (0, 0, 0))

        def draw() -> GlImage:
            drawn = scene if stiff else self._scene(shapes, camera, paint, lights, "gouraud", (0, 0, 0))
            return self._drawn(drawn, "gouraud")

        return draw

    def _drawn(self, scene: Any, shading: Shading) -> GlImage:
        gl = self._pyrender
        flags = gl.RenderFlags.NONE if shading == "smooth" else gl.RenderFlags.FLAT
        colour, _ = self._renderer.render(scene, flags=flags)
        names = {node: (int(node.name) + 1, 0, 0) for node in scene.mesh_nodes}
        # This pass looks at pixel centres; that of the colours takes its depth from a sample beside them.
        ids, depth = self._renderer.render(scene, flags=gl.RenderFlags.SEG, seg_node_map=names)
        return GlImage(colour, _depth(depth.astype(float), scene.main_camera_node.camera), ids[..., 0].astype(int) - 1)

    def _scene(self, shapes, camera, paint, lights, shading, background) -> Any:
        gl = self._pyrender
        scene = gl.Scene(bg_color=[*(level / 255.0 for level in background), 1.0], ambient_light=[lights.ambient] * 3)
        near, far = _clip(shapes, camera)
        pose = np.eye(4)
        if camera.kind == "perspective":
            # Pyrender's images count from the corner of the first pixel, ours from its centre.
            lens = gl.IntrinsicsCamera(camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, near, far)
        else:
            half = (0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy)
            lens = gl.OrthographicCamera(*half, znear=near, zfar=far)
            pose[0, 3] = half[0] - (camera.cx + 0.5) / camera.fx
            pose[1, 3] = (camera.cy + 0.5) / camera.fy - half[1]
        scene.add(lens, pose=pose)
        colours = _colours(shapes, camera, paint, lights, shading)
        for part in np.unique(shapes.part):
            mine = shapes.triangles[shapes.part == part]
            scene.add(self._mesh(shapes, mine, colours, shapes.part == part, shading), name=str(part))
        if shading == "smooth":
            for direction, strength in zip(lights.direction, lights.strength, strict=True):
                power = float(strength.max())
                light = gl.DirectionalLight(color=strength / max(power, 1e-9), intensity=np.pi * power)
                scene.add(light, pose=_towards(direction))
        return scene

    def _mesh(self, shapes: Triangles, triangles, colours, chosen, shading: Shading) -> Any:
        gl = self._pyrender
        if shading == "flat":
            corners = shapes.vertices[triangles].reshape(-1, 3)
            tint = np.repeat(colours[chosen], 3, axis=0)
            positions, normals, indices = corners, np.zeros_like(corners), None
        else:
            used, indices = np.unique(triangles, return_inverse=True)
            positions, normals, tint = shapes.vertices[used], shapes.normals[used], colours[used]
            indices = indices.reshape(-1, 3)
        material = gl.MetallicRoughnessMaterial(metallicFactor=0.0, roughnessFactor=0.8, doubleSided=True)
        rgba = np.column_stack([np.clip(tint / 255.0, 0.0, 1.0), np.ones(tint.shape[0])])
        primitive = gl.Primitive(
            (positions @ _TO_GL).astype(np.float32),
            normals=(normals @ _TO_GL).astype(np.float32),
            color_0=rgba.astype(np.float32),
            indices=indices,
            material=material,
        )
        return gl.Mesh([primitive])


def _colours(shapes: Triangles, camera: Camera, paint: Paint, lights: Lights, shading: Shading):
    """Colours of triangles (`flat`) or vertices: lit, or bare for pyrender's own lights."""
    if shading == "flat":
        corners = shapes.vertices[shapes.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        middle = Triangles(
            corners.mean(axis=1), normal, shapes.own[shapes.triangles].mean(axis=1), shapes.triangles, shapes.part
        )
        return vertex_colours(middle, shapes.part, camera, paint, lights)
    part = np.zeros(shapes.vertices.shape[0], np.int64)
    part[shapes.triangles] = shapes.part[:, None]
    if shading == "smooth":
        share = plain.mixture(paint.texture[part], shapes.own / paint.grain[part][:, None], lattice())[:, None]
        return paint.colour[part] + share * (paint.second[part] - paint.colour[part])
    return vertex_colours(shapes, part, camera, paint, lights)


def _clip(shapes: Triangles, camera: Camera) -> tuple[float, float]:
    """Depths between which OpenGL draws: as close to the surfaces as they allow, for the Z-buffer's sake."""
    z = shapes.vertices[:, 2]
    low, high = (float(z.min()), float(z.max())) if z.size else (1.0, 2.0)
    return max(0.98 * low - 1.0, 1.0), max(1.02 * high + 1.0, 3.0)


def _depth(given: Float[np.ndarray, "h w"], lens: Any) -> Float[np.ndarray, "h w"]:
    """Camera z, inf where nothing is; pyrender reads the Z-buffer of every camera as if it were a perspective one."""
    near, far = lens.znear, lens.zfar
    nothing = given == 0
    depth = np.where(nothing, near, given)
    if not hasattr(lens, "fx"):
        share = far * (depth - near) / (depth * (far - near))
        depth = near + share * (far - near)
    return np.where(nothing, np.inf, depth)


def _towards(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Pose of a light, which shines along its -z."""
    pose = np.eye(4)
    pose[:3, :3] = _across(_TO_GL @ direction)[[1, 2, 0]].T
    return pose


def load(platform: Platform = "egl") -> tuple[ModuleType, Platform]:
    """Pyrender, and a platform that works.

    Raises
    ------
    InputError
        If it is not installed, or neither platform can be loaded.
    """
    if not hasattr(np, "infty"):
        setattr(np, "infty", np.inf)  # noqa: B010 - the plain form reads like a use of the name
    problem = ""
    for name in (platform, _OTHER[platform]):
        with _chosen(name):
            try:
                import pyrender

                pyrender.OffscreenRenderer(8, 8).delete()
                return pyrender, name
            except ModuleNotFoundError as error:
                raise InputError(f"the OpenGL renderer needs pyrender ({error}); install handtrack[gl]") from error
            except Exception as error:  # noqa: BLE001 - drivers fail in many ways; all mean that this one is no good
                problem = problem or f"{name}: {type(error).__name__}: {error}"
    raise InputError(f"OpenGL cannot be used without a screen, neither by EGL nor by OSMesa ({problem})")


@contextmanager
def _chosen(platform: Platform) -> Iterator[None]:
    """The environment in which pyrender and OpenGL choose a platform; as it was, afterwards."""
    before = os.environ.get("PYOPENGL_PLATFORM")
    os.environ["PYOPENGL_PLATFORM"] = platform
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYOPENGL_PLATFORM"]
        else:
            os.environ["PYOPENGL_PLATFORM"] = before
