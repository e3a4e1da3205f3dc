"""Claims about scene files and the shots drawn from them: what is refused, what is drawn, and on what it depends."""

import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from made_hand import glb, made_hand
from pydantic import BaseModel

from handtrack.camera import project_camera
from handtrack.errors import InputError
from handtrack.kinematics.tree import Model
from synth.dataset.draw import Source, prepare, shot
from synth.dataset.scene_file import SceneFile, read_scene
from synth.dataset.scene_schema import SceneSchema
from synth.labels.bodies import Body, PillHand, Rigid
from synth.labels.shot import Shot, keypoints_at

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "datasets-scenes.md").read_text("utf-8")
SCENES = sorted((ROOT / "examples" / "scenes").glob("*dataset.yaml"))
START = "format: handtrack/scene-1\n"
TINY = "image: {width: 64, height: 48}\n"
EXAMPLES = [*(path.stem for path in SCENES), "page"]
ONE_OF = st.integers(0, 10**6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where scenes of this module lie, with the files that they refer to."""
    made = tmp_path_factory.mktemp("scenes")
    (made / "hand.glb").write_bytes(glb(made_hand()))
    (made / "wedge.obj").write_text(
        "# a wedge\nv 0 0 0\nv 2 0 0\nv 2 1 0 \nv 0 1 0\nv 0 0 1\nf 1/1 4 3 2\nf -5 -4 -1\n"
    )
    (made / "photos").mkdir()
    gradient = np.arange(90 * 120 * 3, dtype=np.uint32).reshape(90, 120, 3) % 251
    cv2.imwrite(str(made / "photos" / "b.png"), gradient.astype(np.uint8))
    cv2.imwrite(str(made / "photos" / "a.jpg"), np.full((20, 200, 3), (30, 20, 10), np.uint8))
    return made


def scene_of(folder: Path, text: str) -> SceneFile:
    path = folder / "scene.yaml"
    path.write_text(START + text, "utf-8")
    return read_scene(path)


def source_of(folder: Path, text: str, seed: int = 1) -> Source:
    return prepare(scene_of(folder, TINY + text), seed)


def example_source(folder: Path, name: str, seed: int = 1) -> Source:
    if name == "page":
        (folder / "page.yaml").write_text(re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)[1], "utf-8")
        return prepare(read_scene(folder / "page.yaml"), seed)
    return prepare(read_scene(ROOT / "examples" / "scenes" / f"{name}.yaml"), seed, folder / "hand.glb")


def leaves(value, place: str = "shot"):
    """Places and values of everything in nested dataclasses and tuples."""
    if is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name), f"{place}.{field.name}")
    elif isinstance(value, tuple):
        yield f"{place}.length", len(value)
        for i, item in enumerate(value):
            yield from leaves(item, f"{place}[{i}]")
    else:
        yield place, value


def differences(one, two) -> list[str]:
    """Places at which two nested dataclasses are not bit for bit the same."""
    a, b = dict(leaves(one)), dict(leaves(two))
    shared = [place for place in a if place in b]
    apart = [place for place in shared if not np.array_equal(a[place], b[place], equal_nan=_is_number(a[place]))]
    return apart + sorted(a.keys() ^ b.keys())


def _is_number(value) -> bool:
    return np.asarray(value).dtype.kind == "f"


def list_of_schemas(schema: type[BaseModel]):
    """A schema and all within it."""
    yield schema
    for field in schema.model_fields.values():
        kinds = [field.annotation, *getattr(field.annotation, "__args__", ())]
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from list_of_schemas(kind)


def hand_model(body: Body) -> Model:
    assert isinstance(body.shape, PillHand)
    return body.shape.model


def world_points(one: Shot, hand: int = 0) -> np.ndarray:
    return (keypoints_at(one, 0.0).p_cam[hand] - one.camera.t) @ one.camera.R


# Files that are refused

REFUSED = [
    ("line 1: unknown key 'imaeg'; known are format, image, sequence, camera", "imaeg: {}"),
    (r"line 2: image\.width: 15 given; wanted: greater than or equal to 16", "image: {width: 15}"),
    (r"line 2: image\.height: 5000 given; wanted: less than or equal to 4096", "image: {height: 5000}"),
    (r"line 2: image\.width: 64\.5 given; wanted: a integer", "image: {width: 64.5}"),
    (r"line 2: image\.type: 'gif' given; wanted: 'png' or 'jpg'", "image: {type: gif}"),
    (r"line 2: image: 3 given; wanted: keys", "image: 3"),
    (r"line 2: sequence\.frames: 0 given; wanted: greater than or equal to 1", "sequence: {frames: 0}"),
    (r"line 2: sequence\.fps: 0 given; wanted: greater than 0", "sequence: {fps: 0}"),
    (r"line 2: camera: unknown key 'fow'; known are type, fov", "camera:\n  fow: 50"),
    (r"line 3: camera\.fov: 'wide' given; wanted: a number", "camera:\n  fov: wide"),
    (
        r"line 2: camera\.fov: \[60, 40\] given; .*a number or \[low, high\] within 1\.\.150",
        "camera: {fov: [60, 40]}",
    ),
    (r"line 2: camera\.fov: \[1, 2, 3\] given; wanted: a number", "camera: {fov: [1, 2, 3]}"),
    (r"line 2: '\.nan' is not a finite number", "camera: {fov: .nan}"),
    (r"line 2: camera\.towards: 'up' given; wanted: 'palm', 'back'", "camera: {towards: up}"),
    (r"line 2: camera\.distortion: unknown key 'k4'", "camera: {distortion: {k4: 1}}"),
    (r"line 2: key 'k1' is given twice", "camera: {distortion: {k1: 1, k1: 2}}"),
    (r"line 2: hands: \[\] given; wanted: a list with at least 1", "hands: []"),
    (r"line 2: hands: .* given; wanted: a list with at most 2", "hands: [{}, {}, {}]"),
    (r"line 3: hands\[0\]\.kind: 'glove' given; wanted: 'pills' or 'mesh'", "hands:\n  - kind: glove"),
    (r"line 4: hands\[0\]\.pose\.speed: \[0, 50\] given; .*within 0\.\.45", "hands:\n- pose:\n    speed: [0, 50]"),
    (
        r"line 2: hands\[0\]\.model: 'third_hand' is no file; it is looked for beside",
        "hands: [{model: third_hand}]",
    ),
    (r"line 2: hands\[0\]\.mesh: '\.\./a\.glb' leaves the folder", "hands: [{kind: mesh, mesh: ../a.glb}]"),
    (r"line 2: hands\[0\]\.mesh: '/a\.glb' is absolute", "hands: [{kind: mesh, mesh: /a.glb}]"),
    (r"line 2: hands\[0\]\.pose: 'file' is missing", "hands: [{pose: {type: file}}]"),
    (r"line 2: hands\[0\]\.pose\.file: 'a\.bvh' is no file", "hands: [{pose: {type: file, file: a.bvh}}]"),
    (r"line 2: occluders\[0\]: 'kind' is missing", "occluders: [{}]"),
    (r"line 2: occluders\[1\]: 'mesh' is missing", "occluders: [{kind: box}, {kind: mesh}]"),
    (r"line 2: occluders\[0\]\.mesh: 'photos' is no file", "occluders: [{kind: mesh, mesh: photos}]"),
    (r"line 2: occluders\[0\]\.count: 1\.5 given; wanted: a integer", "occluders: [{kind: box, count: 1.5}]"),
    (r"line 2: occluders\[0\]\.count: 13 given; .*within 0\.\.12", "occluders: [{kind: box, count: 13}]"),
    (r"line 2: occluders\[0\]\.textures: \[\] given; wanted: a list", "occluders: [{kind: box, textures: []}]"),
    (r"line 2: .*textures\[0\]: 'wood' given; wanted: 'plain'", "occluders: [{kind: box, textures: [wood]}]"),
    (r"line 2: background: 'folder' is missing", "background: {kind: images}"),
    (r"line 2: background\.folder: 'x' is no folder", "background: {kind: images, folder: x}"),
    (r"line 2: background\.folder: 'empty' holds no images; wanted", "background: {kind: images, folder: empty}"),
    (r"line 2: labels\.depth: 1 given; wanted: a boolean", "labels: {depth: 1}"),
    (r"line 2: labels\.depth_unit: 0 given; wanted: greater than 0", "labels: {depth_unit: 0}"),
]


@pytest.mark.parametrize(("message", "text"), REFUSED, ids=range(len(REFUSED)))
def test_a_bad_scene_is_refused_in_one_line(folder, message, text):
    (folder / "empty").mkdir(exist_ok=True)
    with pytest.raises(InputError, match=message) as refusal:
        scene_of(folder, text)
    assert "\n" not in str(refusal.value) and "scene.yaml" in str(refusal.value)


@pytest.mark.parametrize("kind", ["pills", "mesh"])
def test_a_mesh_hand_without_a_mesh_is_refused_only_if_it_is_needed(folder, kind):
    scene = scene_of(folder, f"hands: [{{kind: {kind}}}]")
    if kind == "mesh":
        with pytest.raises(InputError, match=r"hands\[0\]: 'mesh' is missing; name a file here or give --surface"):
            prepare(scene, 1)
    else:
        prepare(scene, 1)


# What is drawn


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_example_draws_shots_with_its_hands_in_view(folder, name):
    source = example_source(folder, name)
    hands = len(source.scene.schema.hands)
    inside = []
    for index in range(0, 400, 47):
        one = shot(source, index)
        points = keypoints_at(one, 0.0)
        u, v = np.moveaxis(project_camera(one.camera, points.p_cam), -1, 0)
        inside.append((u >= 0) & (u < one.camera.width) & (v >= 0) & (v < one.camera.height))
        assert points.p_cam.shape == (hands, 21, 3)
    assert np.mean([place[0].mean() for place in inside]) > 0.7


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_shot_depends_on_scene_seed_and_number_only(folder, name):
    numbers = [7, 0, 31, 3]
    first = {i: shot(example_source(folder, name), i) for i in numbers[:2]}
    source = example_source(folder, name)
    later = {i: shot(source, i) for i in reversed(numbers)}
    for i in first:
        assert differences(first[i], later[i]) == []
    assert differences(later[0], shot(example_source(folder, name, seed=2), 0)) != []
    assert differences(later[7], later[31]) != []


@settings(max_examples=25, deadline=None)
@given(
    fov=st.tuples(st.floats(20, 90), st.floats(0, 30)),
    distance=st.tuples(st.floats(200, 800), st.floats(0, 300)),
    noise=st.tuples(st.floats(0, 10), st.floats(0, 10)),
    scale=st.tuples(st.floats(0.5, 1.2), st.floats(0, 0.5)),
    index=ONE_OF,
)
def test_values_lie_in_their_ranges(folder, fov, distance, noise, scale, index):
    given = {"fov": fov, "distance": distance, "noise": noise, "scale": scale}
    ranges = {key: [low, low + more] for key, (low, more) in given.items()}
    text = (
        f"camera: {{fov: {ranges['fov']}, distance: {ranges['distance']}}}\n"
        f"hands: [{{scale: {ranges['scale']}}}]\nsensor: {{noise: {ranges['noise']}}}\n"
    )
    source = source_of(folder, text)
    one = shot(source, index)
    seen = {
        "fov": 2.0 * np.degrees(np.arctan(0.5 * one.camera.width / one.camera.fx)),
        "distance": one.camera.t[2],
        "noise": one.exposure.noise,
        "scale": hand_model(one.bodies[0]).link_length[1] / source.hands[0][0].model.link_length[1],
    }
    for key, value in seen.items():
        low, high = ranges[key]
        assert low - 1e-6 * high <= value <= high + 1e-6 * high, key


@given(towards=st.sampled_from(["palm", "back", "thumb", "little", "fingertips"]), index=ONE_OF)
@settings(max_examples=25, deadline=None)
def test_the_camera_stands_where_it_is_told_to(folder, towards, index):
    one = shot(source_of(folder, f"camera: {{towards: {towards}, cone: [0, 20], off_centre: 0}}"), index)
    points = world_points(one)
    ahead = points[9] - points[0]  # wrist to the knuckle of the middle finger
    across = points[5] - points[17]  # little finger to index
    out = {
        "fingertips": ahead,
        "thumb": across,
        "little": -across,
        "palm": -np.cross(ahead, across),
        "back": np.cross(ahead, across),
    }[towards]
    eye = -one.camera.R.T @ one.camera.t - points[[5, 9, 13, 17]].mean(axis=0)
    cosine = out @ eye / np.linalg.norm(out) / np.linalg.norm(eye)
    assert cosine > np.cos(np.radians(50.0))


def test_the_next_frame_of_a_sequence_goes_on_where_this_one_ends(folder):
    source = source_of(
        folder, "sequence: {frames: 5}\nhands: [{motion: {translation: 3, rotation: 2}, pose: {speed: 4}}]"
    )
    for index in range(4):
        now, then = shot(source, index), shot(source, index + 1)
        np.testing.assert_array_equal(now.bodies[0].q[1], then.bodies[0].q[0])
        np.testing.assert_array_equal(now.bodies[0].placed.t[1], then.bodies[0].placed.t[0])
    assert not np.array_equal(now.bodies[0].q[0], now.bodies[0].q[1])
    assert differences(shot(source, 4), replace(shot(source, 5), index=4, frame=4)) != []


SAME = ("camera", "lights", "exposure", "background")


@pytest.mark.parametrize(
    ("added", "kept"),
    [
        ("occluders: [{kind: box}, {kind: sphere}]", SAME),
        ("occluders: [{kind: box}]\nsensor: {noise: [5, 9]}", SAME[:2] + SAME[3:]),
        ("occluders: [{kind: box}]\nlights: {count: 5}", ("camera", "exposure", "background")),
    ],
)
def test_one_more_choice_keeps_the_others(folder, added, kept):
    for index in range(5):
        one = shot(source_of(folder, "occluders: [{kind: box}]"), index)
        other = shot(source_of(folder, added), index)
        for name in kept:
            assert differences(getattr(one, name), getattr(other, name)) == [], name
        for a, b in zip(one.bodies, other.bodies, strict=False):
            assert differences(a.placed, b.placed) == []
            np.testing.assert_array_equal(a.q, b.q)


def test_free_occluders_stand_between_camera_and_hand(folder):
    source = source_of(folder, "occluders: [{kind: sphere, nearer: [0.3, 0.8], aside: 0, size: 30}]")
    for index in range(10):
        one = shot(source, index)
        points = keypoints_at(one, 0.0).p_cam[0]
        centre = one.camera.R @ one.bodies[1].placed.t[0] + one.camera.t
        along = points / np.linalg.norm(points, axis=1, keepdims=True)
        aside = np.linalg.norm(centre - (along @ centre)[:, None] * along, axis=1)
        assert aside.min() < 1e-6
        target = points[aside.argmin()]
        assert 0.2 - 1e-9 <= centre[2] / target[2] <= 0.7 + 1e-9


def test_what_is_held_moves_with_the_palm(folder):
    source = source_of(
        folder,
        "sequence: {frames: 6}\nhands: [{motion: {translation: 5, rotation: 5}, pose: {spread: 0}}]\n"
        "occluders: [{kind: pill, place: grasped, size: 30}]",
    )
    held = [i for i in range(30) if len(shot(source, 6 * i).bodies) > 1]
    assert len(held) > 10
    first, last = (shot(source, 6 * held[0] + frame).bodies for frame in (0, 5))
    seen = [b[0].placed.R[0].T @ (b[1].placed.t[0] - b[0].placed.t[0]) for b in (first, last)]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-9)
    assert not np.allclose(first[1].placed.t[0], last[1].placed.t[0], atol=0.1)


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "glb"])
def test_an_occluder_may_be_a_mesh_file_of_any_kind(folder, ending):
    mesh = trimesh.creation.box(extents=(3.0, 2.0, 1.0))
    mesh.export(folder / f"brick.{ending}")
    source = source_of(folder, f"occluders: [{{kind: mesh, mesh: brick.{ending}, size: 40}}]")
    body = shot(source, 0).bodies[1].shape
    assert isinstance(body, Rigid)
    np.testing.assert_allclose(np.sort(np.ptp(body.vertices, axis=0)), [40 / 3, 80 / 3, 40], rtol=1e-5)


def test_mesh_files_that_are_none_are_refused(folder):
    (folder / "words.ply").write_text("ply, but not really\n")
    (folder / "point.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    trimesh.PointCloud(np.eye(3)).export(folder / "points.ply")
    for name, message in (("words", "a mesh is wanted"), ("points", "triangles"), ("point", "one place")):
        with pytest.raises(InputError, match=message):
            source_of(folder, f"occluders: [{{kind: mesh, mesh: {name}.{'obj' if name == 'point' else 'ply'}}}]")


def test_backgrounds_come_from_the_folder(folder):
    source = source_of(folder, "background: {kind: images, folder: photos}")
    grey = [np.ptp(shot(source, i).background.astype(int), axis=(0, 1)).max() for i in range(20)]
    assert min(grey) == 0 < max(grey)  # pieces of the plain image, and of the other


def test_the_documentation_names_every_key():
    """First columns of its tables and headings, against the schema."""
    named = set(re.findall(r"`(\w+):?`", "\n".join(re.findall(r"^(?:#+|\|) (.*?)(?: \||$)", PAGE, re.MULTILINE))))
    for schema in list_of_schemas(SceneSchema):
        assert schema.model_fields.keys() - {"format"} <= named, schema.__name__
