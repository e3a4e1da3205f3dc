"""The mesh renderer against rays, the tree it makes against the mesh, and sequences of it from the command line."""

import re

import numpy as np
import pytest
from made_hand import glb, made_hand

from handtrack.camera import orthographic, perspective, rays
from handtrack.cli import main
from handtrack.cli.rendering import MeshOptions, build
from handtrack.cli.skinned import open_surface
from handtrack.errors import InputError
from handtrack.formats.glb import SkinnedMesh
from handtrack.kinematics import forward, link_ends
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.sequences import open_sequence
from handtrack.settings import Settings
from synth.mesh import posed_hand, render_hand, sample_places
from synth.mesh_hand import DARK, FINGERS, TONE, mesh_hand, resized
from synth.mesh_scene import mesh_scene
from synth.scene import LIGHT, clean_image, image
from synth.sequence import write_sequence
from synth.shading import Material

MESH = made_hand()
MODEL, HAND = mesh_hand(MESH, FINGERS, abduction=True)
WHITE = Material(np.full((1, 3), 200.0))
FLAT = np.diag([1.0, -1.0, -1.0])


def hits(mesh: SkinnedMesh, p: np.ndarray, origin: np.ndarray, direction: np.ndarray):
    """Nearest triangle of each ray by Moeller and Trumbore's test against all, and its barycentric coordinates."""
    a, b, c = (p[mesh.triangles[:, i]] for i in range(3))
    found = []
    for o, d in zip(origin, direction, strict=True):
        e1, e2 = b - a, c - a
        h = np.cross(d, e2)
        det = (e1 * h).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - a
            l1 = (s * h).sum(axis=1) / det
            q = np.cross(s, e1)
            l2 = (q @ d) / det
            t = (e2 * q).sum(axis=1) / det
        t = np.where((l1 >= 0) & (l2 >= 0) & (l1 + l2 <= 1) & (t > 0), t, np.inf)
        k = int(np.argmin(np.nan_to_num(t, nan=np.inf)))
        found.append((k, 1.0 - l1[k] - l2[k], l1[k], l2[k]) if np.isfinite(t[k]) else (-1, 0.0, 0.0, 0.0))
    return found


@pytest.mark.parametrize(
    "camera",
    [
        orthographic(60, 50, 0.28, 30.0, 27.0, FLAT, np.array([0.0, 0.0, 300.0])),
        perspective(60, 50, 90.0, 85.0, 30.0, 27.0, FLAT, np.array([0.0, 0.0, 320.0])),
    ],
)
def test_one_sample_a_pixel_shows_what_a_ray_meets(camera):
    q = np.full(len(MODEL.joint_names), 0.3)
    made = render_hand(HAND, MODEL, q, camera, WHITE, LIGHT, 7.0, samples=1)
    vertices, normals = posed_hand(HAND, MODEL, q)
    p, n = vertices @ camera.R.T + camera.t, normals @ camera.R.T
    rng = np.random.default_rng(1)
    xy = np.column_stack([rng.integers(0, 60, 250), rng.integers(0, 50, 250)])
    origin, direction = rays(camera, xy.astype(float))
    light = LIGHT.direction / np.linalg.norm(LIGHT.direction)
    for (x, y), hit in zip(xy.tolist(), hits(MESH, p, origin, direction), strict=True):
        if hit[0] < 0:
            assert made[y, x] == pytest.approx(7.0)
            continue
        corner, share = MESH.triangles[hit[0]], np.array(hit[1:])
        normal, place = share @ n[corner], share @ p[corner]
        normal = normal / np.linalg.norm(normal)
        eye = -place / np.linalg.norm(place) if camera.kind == "perspective" else np.array([0.0, 0.0, -1.0])
        facing = float(normal @ light)
        level = TONE * (WHITE.ambient + WHITE.diffuse * max(facing, 0.0))
        if facing > 0.0:
            mirrored = max(float(2.0 * facing * (normal @ eye) - light @ eye), 0.0)
            level += 255.0 * WHITE.specular * mirrored**WHITE.shininess
        assert made[y, x] == pytest.approx(level, abs=1e-6)


def test_many_samples_tend_to_the_area_of_a_pixel():
    camera = orthographic(60, 50, 0.28, 30.0, 27.0, FLAT, np.array([0.0, 0.0, 300.0]))
    q = np.zeros(len(MODEL.joint_names))
    few, more = (render_hand(HAND, MODEL, q, camera, WHITE, LIGHT, 0.0, samples=count) for count in (64, 1024))
    assert np.abs(few - more).max() < 12.0 and np.sqrt(((few - more) ** 2).mean()) < 0.8


def test_sample_places_lie_evenly_in_the_pixel():
    for count in (1, 5, 64):
        places = sample_places(count)
        assert np.abs(places).max() < 0.5
        np.testing.assert_allclose(np.sort(places[:, 0]), (np.arange(count) + 0.5) / count - 0.5)
    np.testing.assert_allclose(sample_places(64).mean(axis=0), 0.0, atol=0.01)


def test_the_tree_has_its_links_along_the_bones_and_bends_towards_the_palm():
    ends = link_ends(MODEL, forward(MODEL, np.zeros(len(MODEL.joint_names))))
    tips = {name: MESH.bind[i, :3, 3] for i, name in enumerate(MESH.joint_names) if name.endswith("-tip")}
    last = ends[1][MODEL.link_is_tip]
    for tip in tips.values():
        assert np.linalg.norm(last - tip, axis=1).min() < 1e-9
    for joint, name in enumerate(MODEL.joint_names):
        if name.endswith(("_pip", "_dip")):
            bent = 0.3 * (np.arange(len(MODEL.joint_names)) == joint)
            palmwards = link_ends(MODEL, forward(MODEL, bent))[1] - ends[1]
            assert palmwards[:, 2].min() < -2.0 and palmwards[:, 2].max() < 1e-9
    assert (MODEL.link_radius > 4.0).all() and (MODEL.link_radius < 12.0).all()


def test_at_pose_zero_the_skin_is_the_mesh():
    vertices, normals = posed_hand(HAND, MODEL, np.zeros(len(MODEL.joint_names)))
    np.testing.assert_allclose(vertices, MESH.vertices, atol=1e-9)
    np.testing.assert_allclose(normals, MESH.normals, atol=1e-9)


def test_a_covered_palm_is_dark_and_fingers_are_not():
    albedo = mesh_hand(MESH, covered=True)[1].albedo
    assert albedo.min() == DARK and albedo.max() == pytest.approx(TONE)
    assert (albedo[MESH.joint[:, 0] == MESH.joint_names.index("thumb-tip")] <= DARK + 1e-9).all()


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="scale: 0"):
        resized(MESH, 0.0)
    with pytest.raises(ValueError, match="fingers: 'toe' is unknown"):
        mesh_hand(MESH, ("toe",))
    names = tuple(name.replace("ring-finger-tip", "wrist") for name in MESH.joint_names)
    lacking = SkinnedMesh(
        MESH.vertices, MESH.normals, MESH.triangles, names, MESH.parent, MESH.bind, MESH.joint, MESH.weight
    )
    with pytest.raises(ValueError, match="no joint 'ring-finger-tip'"):
        mesh_hand(lacking)
    near = perspective(60, 50, 90.0, 85.0, 30.0, 27.0, FLAT, np.array([0.0, 0.0, 10.0]))
    with pytest.raises(ValueError, match="behind it"):
        render_hand(HAND, MODEL, np.zeros(len(MODEL.joint_names)), near, WHITE, LIGHT)


def test_the_same_seed_gives_the_same_scene_and_another_one_does_not():
    one, same, other = (mesh_scene(seed, MESH, frames=3, size=(160, 120), zoom=0.7) for seed in (1, 1, 2))
    np.testing.assert_array_equal(image(one, 2), image(same, 2))
    assert np.abs(one.truth - other.truth).max() > 0.01
    assert np.degrees(np.abs(np.diff(one.truth, axis=0))).max() <= 3.0 + 1e-6
    palm = mesh_scene(1, MESH, frames=3, size=(160, 120), zoom=0.7, palm=True, turn=10.0)
    assert np.linalg.det(palm.camera.R) == pytest.approx(1.0)
    assert np.abs(clean_image(palm, 0) - clean_image(one, 0)).max() > 50.0


def test_a_rendered_mesh_sequence_is_tracked_evaluated_and_reported_from_the_command_line(tmp_path, capsys):
    """The whole way, with two views and a mesh of another size and side than that of the file."""
    (tmp_path / "hand.glb").write_bytes(glb(MESH))
    hand, clip, run = str(tmp_path / "hand.glb"), str(tmp_path / "clip"), tmp_path / "run"
    options = ["--mirror", "--hand-scale", "0.9", "--tilt", "20", "--frames", "2", "--noise", "1"]
    assert main(["render", "--scene", "mesh", "--surface", hand, *options, "--out", clip]) == 0
    assert open_sequence(tmp_path / "clip").truth is not None
    assert main(["track", clip, "--surface", hand, "--out", str(run)]) == 0
    assert '"surface"' in (run / "run.json").read_text() and (run / "overlay.mp4").stat().st_size > 1000
    assert main(["evaluate", str(run)]) == 0
    assert "worst joint" in capsys.readouterr().out
    assert main(["explain", str(run), "1"]) == 2
    assert "was tracked with a skinned surface" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "match"),
    [
        (["track", "{clip}", "--surface", "{clip}/none.glb"], "none.glb: no such file"),
        (["track", "{clip}", "--surface", "{clip}/sequence.yaml"], "is no glTF"),
        (["track", "{clip}", "--surface", "{hand}", "--refine"], "--refine: is for pills"),
        (["render", "--scene", "mesh"], "--surface: goes with"),
        (["render", "--mirror"], "--surface: goes with"),
        (["render", "--scene", "mesh", "--surface", "{hand}", "--model", "rr"], "--model: a mesh brings its own"),
        (["render", "--scene", "mesh", "--surface", "{hand}", "--colour"], "a mesh is shown in grey"),
    ],
)
def test_bad_input_ends_with_one_line_and_code_two(tmp_path, capsys, command, match):
    hand, clip = tmp_path / "hand.glb", tmp_path / "clip"
    hand.write_bytes(glb(MESH))
    write_sequence(clip, mesh_scene(1, MESH, frames=1, size=(64, 48), zoom=0.3))
    asked = [part.format(hand=hand, clip=clip) for part in command]
    assert main([*asked, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert re.search(match, said) and said.count("error:") == 1 and not (tmp_path / "out").exists()


def test_a_model_of_another_hand_is_an_input_error(tmp_path):
    (tmp_path / "hand.glb").write_bytes(glb(MESH))
    with pytest.raises(InputError, match=r"hand\.glb: m.*(from those of model|on one line)"):
        open_surface(tmp_path / "hand.glb", builtin_model("index"), Settings())


def test_a_mesh_without_its_fingers_is_an_input_error(tmp_path):
    def change(content) -> None:
        content["nodes"] = content["nodes"][:-1]
        content["skins"][0]["joints"].pop()

    (tmp_path / "hand.glb").write_bytes(glb(MESH, change))
    with pytest.raises(InputError, match="no joint 'pinky-finger-tip'"):
        build("mesh", None, 1, 1, 1, MeshOptions(tmp_path / "hand.glb"))
