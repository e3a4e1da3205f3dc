"""Compiled loops as a whole: each names a twin that exists; no surprises with empty input, side effects or threads.

The comparisons of single kernels with their twins stand in the tests of the modules that use them.
"""

import importlib
import pkgutil
import re
from dataclasses import fields, is_dataclass, replace
from operator import attrgetter

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import handtrack
from handtrack import _kernels
from handtrack.appearance import learn
from handtrack.edges import find_edges
from handtrack.fit import fit
from handtrack.kinematics import Coupling, FrameRow, forward, model_from_rows, pose_from_free
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, pose_pills, ray_hits
from handtrack.profiles import place_outline, sample
from handtrack.residuals import Chain, OutlineFeatures, Robust, WithPrior, chain, in_world, outline_residuals, rows
from handtrack.scatter import Scatter, Whitened, whitener
from handtrack.settings import Settings
from handtrack.solve import solve
from handtrack.templates import expect, positions
from synth.scenes import image, posed, two_finger_crossing

CLIP = two_finger_crossing(1, frames=2, projection="perspective")
PICTURE, PILLS = image(CLIP, 0), posed(CLIP, 0)
FINGERS = CLIP.model.link_finger


def kernels() -> dict[str, Dispatcher]:
    """Every compiled function of the package, by module and name."""
    parts = pkgutil.iter_modules(getattr(_kernels, "__path__", []), "handtrack._kernels.")
    modules = [_kernels, *(importlib.import_module(part.name) for part in parts)]
    return {
        f"{module.__name__}.{name}": value
        for module in modules
        for name, value in vars(module).items()
        if isinstance(value, Dispatcher)
    }


KERNELS = kernels()


def twin_of(kernel: Dispatcher) -> str | None:
    found = re.search(r"[Tt]win: `([\w.]+)`", kernel.py_func.__doc__ or "")
    return found[1] if found else None


def test_every_named_twin_exists():
    twins = {twin for kernel in KERNELS.values() if (twin := twin_of(kernel))}
    assert len(twins) >= 8
    for twin in twins:
        if twin.startswith("np."):
            assert callable(attrgetter(twin[3:])(np))
            continue
        module, _, name = twin.rpartition(".")
        assert callable(getattr(importlib.import_module(f"{handtrack.__name__}.{module}"), name)), twin


def test_every_kernel_that_others_call_names_its_twin_and_says_what_it_does():
    for name, kernel in vars(_kernels).items():
        if isinstance(kernel, Dispatcher):
            assert kernel.py_func.__doc__
            assert twin_of(kernel) or name == "hit_sphere", f"{name} has no twin"  # a part of hit_pill


@pytest.mark.parametrize("name", KERNELS)
def test_kernels_run_in_one_thread_with_exact_arithmetic(name):
    options = KERNELS[name].targetoptions
    assert not options.get("parallel") and not options.get("fastmath")


def pipeline(pills: Pills, finger: np.ndarray, tips: np.ndarray):
    """One pass of all image kernels."""
    known = learn(PICTURE, PILLS, CLIP.camera)
    known = replace(known, gain=np.ones(pills.base.shape[0]))
    samplers = place_outline(pills, CLIP.camera, tips)
    looks = expect(samplers, pills, finger, CLIP.camera, known)
    seen = sample(PICTURE, samplers, positions(16.0, 10.0, 0.5))
    n = samplers.link.size
    return samplers, looks, seen, find_edges(samplers, looks, seen, np.full(n, 3.0), np.full(n, 2.0), 2.0, 2.0)


def arrays(*values: object) -> list[np.ndarray]:
    """All arrays held by dataclasses."""
    held = [getattr(value, field.name) for value in values if is_dataclass(value) for field in fields(value)]
    return [value for value in held if isinstance(value, np.ndarray)]


def test_no_pills_are_never_hit_and_no_rays_hit_nothing():
    none = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    assert ray_hits(none, np.zeros((3, 3)), np.ones((3, 3))).pill.tolist() == [-1] * 3
    assert ray_hits(PILLS, np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)


def test_links_out_of_the_image_are_looked_at_without_harm():
    away = Pills(PILLS.base + 5000.0 * np.eye(3)[0], PILLS.tip + 5000.0 * np.eye(3)[0], PILLS.radius)
    _, _, seen, edges = pipeline(away, FINGERS, CLIP.model.link_is_tip)
    assert not seen.inside.any() and np.isinf(edges.sigma).all()
    assert np.isfinite(edges.xy).all()


def test_links_behind_the_camera_are_not_looked_at():
    turned = Pills(PILLS.base * -1.0, PILLS.tip * -1.0, PILLS.radius)
    samplers, looks, _, edges = pipeline(turned, FINGERS, CLIP.model.link_is_tip)
    assert samplers.link.size == looks.state.size == edges.reason.size == 0


def test_image_kernels_give_the_same_bytes_twice_and_change_no_input():
    before = [x.copy() for x in (PICTURE, *arrays(PILLS, CLIP.camera))]
    one, two = (pipeline(PILLS, FINGERS, CLIP.model.link_is_tip) for _ in range(2))
    for a, b in zip(arrays(*one), arrays(*two), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(before, (PICTURE, *arrays(PILLS, CLIP.camera)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_edges_do_not_depend_on_the_samplers_beside_them():
    pills = PILLS
    samplers, looks, _, edges = pipeline(pills, FINGERS, CLIP.model.link_is_tip)
    order = np.random.default_rng(0).permutation(samplers.link.size)
    mixed = type(samplers)(*(x[order] for x in arrays(samplers)))
    known = replace(learn(PICTURE, PILLS, CLIP.camera), gain=np.ones(6))
    again = expect(mixed, pills, FINGERS, CLIP.camera, known)
    np.testing.assert_array_equal(again.values, looks.values[order])
    np.testing.assert_array_equal(again.visible, looks.visible[order])
    n = order.size
    seen = sample(PICTURE, mixed, positions(16.0, 10.0, 0.5))
    found = find_edges(mixed, again, seen, np.full(n, 3.0), np.full(n, 2.0), 2.0, 2.0)
    np.testing.assert_array_equal(found.reason, edges.reason[order])
    np.testing.assert_array_equal(found.offset, edges.offset[order])


def coupled_finger() -> Chain:
    pill = {"link_length": 30.0, "link_radius": (9.0, 8.0)}
    table = [
        FrameRow(1, 0, joint="slide", prismatic=True, limits=(-20.0, 20.0)),
        FrameRow(2, 1, 1.57, joint="mcp", limits=(-0.7, 1.5), **pill),
        FrameRow(3, 2, a=30.0, joint="pip", limits=(0.0, 1.7), **pill),
        FrameRow(4, 3, a=30.0, joint="dip", **pill),
    ]
    return chain(model_from_rows("coupled", table, [Coupling("dip", "pip", 0.67)]), CLIP.camera)


@pytest.mark.parametrize("which", ["two_finger", "coupled"])
@pytest.mark.parametrize("seed", range(4))
def test_compiled_fit_ends_where_the_solver_does(which, seed):
    """Robust, whitened, with a prior, gross errors, and some joints on their limits."""
    rng = np.random.default_rng(seed)
    on = chain(builtin_model("two_finger"), CLIP.camera) if which == "two_finger" else coupled_finger()
    low, high = on.model.limits[on.model.free].T
    truth = np.clip(rng.uniform(-0.2, 0.6, low.size), low, high)
    pills = pose_pills(on.model, forward(on.model, pose_from_free(on.model, truth)), on.camera)
    samplers = place_outline(pills, on.camera, on.model.link_is_tip)
    n = samplers.link.size
    sigma = rng.uniform(0.05, 0.3, n)
    offset = sigma * rng.normal(size=n) + np.where(rng.random(n) < 0.1, 4.0, 0.0)
    ray, slope = in_world(on.camera, samplers.ray + offset[:, None] * samplers.slope, samplers.slope)
    features = OutlineFeatures(ray, slope, samplers.link, sigma)
    evidence = rows(on, features, samplers.side)
    white = whitener(sigma, evidence.group, Scatter(1.3, 0.1, np.zeros(2), np.eye(2)))
    start, mean = truth + rng.normal(0, 0.03, low.size), truth + rng.normal(0, 0.03, low.size)
    root = np.eye(low.size) / 0.05
    u = start
    for _ in range(4):  # it stops after a few steps; go on until nothing moves, the robust scale neither
        found = fit(on, features, evidence, white, u, mean, root, Settings(), True)
        u = found.u
    residual = WithPrior(Robust(Whitened(evidence.residual, white), found.spread), mean, root)
    limits = on.model.limits[on.model.free]
    twin = solve(residual, start, method="levenberg-marquardt", bounds=limits, max_steps=60, tolerance=1e-8)
    sigma_u = np.sqrt(np.diag(np.linalg.inv(found.information + root.T @ root)))
    assert (np.abs(found.u - twin.x) < 0.05 * sigma_u + 1e-6).all()
    assert ((found.u >= low) & (found.u <= high)).all()
    assert (np.abs(found.u - truth) < 5 * sigma_u).all()
    assert np.median(np.abs(outline_residuals(on, features, found.u)[0])) < 1.5
