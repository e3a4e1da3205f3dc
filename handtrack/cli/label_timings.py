"""A number of repeats in, times of labelled images out, beside those of OpenGL drawing the same scene.

Both are given what is in memory already. OpenGL gets its best case: a scene built once whose pills are stiff meshes,
colours without its costly lights, depth, and one pass for part numbers; a skinned hand's vertices have to be sent again
for each image. It gives no normals, flow, amodal masks, fractions or keypoints.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from handtrack.errors import InputError
from synth.dataset.draw import prepare, shot
from synth.dataset.scene_file import read_scene
from synth.gl import Twin, as_triangles
from synth.labels.look import Canvas, labelled
from synth.labels.shot import Shot, solids_at

from .timings import Timing, median_ms

SHOTS = 12
SCENE = """format: handtrack/scene-1
image: {width: 640, height: 480}
camera: {fov: 56, distance: 600, off_centre: 0.05}
hands: [{kind: KIND, motion: {translation: 2, rotation: 1}}]
sensor: {noise: 2}
"""


def labels(repeats: int, surface: Path | None, folder: Path) -> list[Timing]:
    """Times of an image with all its labels: a hand of pills, and a skinned one if a mesh is given.

    Parameters
    ----------
    folder : Path
        Where scene files may be written.
    """
    return [_labels(kind, repeats, surface, folder) for kind in ("pills", "mesh") if kind == "pills" or surface]


def _labels(kind: str, repeats: int, surface: Path | None, folder: Path) -> Timing:
    path = folder / f"{kind}.yaml"
    path.write_text(SCENE.replace("KIND", kind), encoding="utf-8")
    source = prepare(read_scene(path), 0, surface)
    shots = [shot(source, index) for index in range(SHOTS)]
    canvas = Canvas(640, 480)
    ours = float(np.mean([median_ms(lambda one=one: labelled(one, canvas), max(3, repeats // 4)) for one in shots]))
    name = f"label a 640x480 image of a hand, {kind}"
    try:
        peer = _by_opengl(shots, max(3, repeats // 10), kind == "pills")
    except InputError:
        return Timing(name, ours)
    return Timing(name, ours, "pyrender: colour, depth, parts", peer)


def _by_opengl(shots: list[Shot], repeats: int, stiff: bool) -> float:
    """Milliseconds that OpenGL takes for an image, on one thread."""
    os.environ.setdefault("LP_NUM_THREADS", "1")
    camera = shots[0].camera
    times = []
    with Twin(camera.width, camera.height) as twin:
        for one in shots[:4]:
            straight = replace(one.camera, distortion=np.zeros(5))
            shapes = as_triangles(solids_at(one, 0.0))
            work = twin.redrawing(shapes, straight, one.paint, one.lights, stiff)
            times.append(median_ms(work, repeats))
    return float(np.mean(times))
