"""The fit of one look: the compiled iteration against the plain solver, robustness, limits and honest information."""

from typing import Literal

import numpy as np
import pytest

from handtrack.camera import Camera, orthographic, perspective
from handtrack.fit import Fit, fit
from handtrack.kinematics import Coupling, FrameRow, Model, forward, model_from_rows, pose_from_free
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import pose_pills
from handtrack.profiles import place_outline
from handtrack.residuals import Chain, OutlineFeatures, chain, outline_features, rows, stack_features, stack_rows
from handtrack.robust import cauchy_weight
from handtrack.scatter import Scatter, first_scatter, whitener
from handtrack.settings import Settings

Solver = Literal["levenberg-marquardt", "gauss-newton", "gauss-newton-one", "damped", "trust-region"]
SIGMA = 0.2  # pixels


def coupled_finger() -> Model:
    """Tapered, offset links on a slide and three joints, the last of which follows the one before."""
    table = [
        FrameRow(1, 0, joint="slide", prismatic=True),
        FrameRow(2, 1, 1.3, 5.0, 2.0, 0.2, joint="mcp", link_length=46.0, link_radius=(11.0, 9.0)),
        FrameRow(
            3, 2, 0.1, 46.0, joint="pip", link_length=27.0, link_radius=(9.0, 8.5), link_tip_offset=(1.0, 2.0, 0.0)
        ),
        FrameRow(4, 3, -0.1, 27.0, joint="dip", link_length=20.0, link_radius=(8.5, 7.0)),
    ]
    return model_from_rows("coupled", table, [Coupling("dip", "pip", 0.67, 0.1)])


MODELS = {
    "two_finger": builtin_model("two_finger"),
    "full_hand": builtin_model("full_hand"),
    "coupled": coupled_finger(),
}


def camera_of(kind: str, seed: int = 1) -> Camera:
    R = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    t = np.array([0.0, 0.0, 420.0]) - R @ [0.0, 60.0, 0.0]
    if kind == "orthographic":
        return orthographic(640, 480, 2.0, 320.0, 240.0, R, t)
    return perspective(640, 480, 800.0, 830.0, 320.0, 240.0, R, t)


class Scene:
    """A model at a random pose, its exact edges, and a prediction some degrees off."""

    def __init__(self, name: str, kind: str = "orthographic", seed: int = 0, views: int = 1, off: float = 0.02) -> None:
        self.model, rng = MODELS[name], np.random.default_rng(seed)
        low, high = np.clip(self.model.limits[self.model.free], -0.7, 0.7).T
        self.u = rng.uniform(0.9 * low, 0.9 * high)
        self.on: list[Chain] = [chain(self.model, camera_of(kind, 1 + view)) for view in range(views)]
        pills = [pose_pills(self.model, forward(self.model, self.q), view.camera) for view in self.on]
        self.samplers = [
            place_outline(each, view.camera, self.model.link_is_tip) for each, view in zip(pills, self.on, strict=True)
        ]
        self.mean = self.u + off * rng.normal(size=self.u.size)
        self.root = np.eye(self.u.size) / 0.05

    @property
    def q(self) -> np.ndarray:
        return pose_from_free(self.model, self.u)

    def edges(
        self, noise: float = 0.0, wild: float = 0.0, seed: int = 0, sigma: float = SIGMA
    ) -> list[OutlineFeatures]:
        """Edges with noise in units of SIGMA, a share of them wild by up to 12 pixels."""
        rng, found = np.random.default_rng(seed), []
        for view, samplers in zip(self.on, self.samplers, strict=True):
            n = samplers.link.size
            offset = SIGMA * noise * rng.normal(size=n)
            offset += np.where(rng.uniform(size=n) < wild, rng.uniform(4.0, 12.0, n) * rng.choice([-1.0, 1.0], n), 0.0)
            xy = samplers.origin + offset[:, None] * samplers.direction
            found.append(outline_features(view.camera, xy, samplers.direction, samplers.link, np.full(n, sigma)))
        return found

    def fit(
        self,
        edges: list[OutlineFeatures],
        solver: Solver = "levenberg-marquardt",
        plain: bool = False,
        rescale: bool = True,
        scatter: Scatter | None = None,
        start: np.ndarray | None = None,
    ) -> Fit:
        """Fit; `plain` takes the road of every other solver."""
        evidence = stack_rows(
            [rows(view, each, s.side) for view, each, s in zip(self.on, edges, self.samplers, strict=True)]
        )
        white = whitener(evidence.sigma, evidence.group, scatter or first_scatter())
        features = None if plain else stack_features(edges)
        begin = self.mean if start is None else start
        chosen = Settings(solver=solver)
        return fit(self.on[0], features, evidence, white, begin, self.mean, self.root, chosen, rescale)


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("wild", [0.0, 0.15])
def test_the_compiled_fit_equals_the_plain_solver(name, kind, wild):
    for seed in range(3):
        scene = Scene(name, kind, seed)
        edges = scene.edges(noise=1.0, wild=wild, seed=seed)
        scatter = Scatter(1.2, 0.1, np.ones(2), np.eye(2))
        ours, twin = (scene.fit(edges, plain=plain, scatter=scatter) for plain in (False, True))
        sigma = np.sqrt(np.diag(np.linalg.inv(twin.information + scene.root.T @ scene.root)))
        np.testing.assert_allclose(ours.u / sigma, twin.u / sigma, atol=0.15 if wild else 0.01)
        np.testing.assert_allclose(ours.spread, twin.spread, rtol=2e-2)
        np.testing.assert_allclose(ours.information, twin.information, rtol=0.1, atol=1e-2 * twin.information.max())


def test_views_are_fitted_together_on_either_road():
    scene = Scene("full_hand", "perspective", 2, views=2)
    edges = scene.edges(noise=1.0)
    ours, twin = scene.fit(edges), scene.fit(edges, plain=True)
    np.testing.assert_allclose(ours.u, twin.u, atol=2e-5)
    alone = Scene("full_hand", "perspective", 2)
    assert ours.r.size > alone.fit(alone.edges(noise=1.0)).r.size
    one = np.linalg.eigvalsh(alone.fit(alone.edges(noise=1.0)).information)[0]
    assert np.linalg.eigvalsh(ours.information)[0] > 2.0 * one, "the second view sees what the first does not"


@pytest.mark.parametrize("name", MODELS)
def test_exact_edges_and_a_faint_prediction_give_the_pose_back(name):
    scene = Scene(name, "perspective", 3, off=0.01)
    scene.root = scene.root * 1e-3
    found = scene.fit(scene.edges(sigma=0.05))
    seen = np.sqrt(np.diag(np.linalg.inv(found.information + 1e-6 * np.eye(scene.u.size)))) < 0.01
    assert seen.sum() >= 2
    np.testing.assert_allclose(found.u[seen], scene.u[seen], atol=2e-4)
    assert np.abs(found.r).max() < 0.1


def test_without_telling_edges_the_prediction_is_returned():
    for plain in (False, True):
        scene = Scene("two_finger", off=0.1)
        scene.mean = np.clip(scene.mean, *scene.model.limits.T)
        start = np.clip(scene.mean + 0.05, *scene.model.limits.T)
        found = scene.fit(scene.edges(noise=1.0, sigma=1e5), plain=plain, start=start)
        np.testing.assert_allclose(found.u, scene.mean, atol=1e-5)
        assert np.abs(found.information).max() < 1e-3


def test_evidence_and_prediction_are_weighed_by_their_information():
    scene = Scene("two_finger", off=0.01)
    found = scene.fit(scene.edges())
    whole = found.information + scene.root.T @ scene.root
    r, J = found.r * found.weight, found.J
    gradient = J.T @ r / found.spread**2 + scene.root.T @ scene.root @ (found.u - scene.mean)
    assert np.abs(np.linalg.solve(whole, gradient)).max() < 1e-5, "a stationary point of the robust cost"
    np.testing.assert_allclose(found.weight, cauchy_weight(found.r / found.spread))


@pytest.mark.parametrize("name", ["two_finger", "coupled"])
def test_a_fifth_of_wild_edges_is_ignored(name):
    worst, light = 0.0, 0.0
    for seed in range(8):
        scene = Scene(name, "perspective", seed, off=0.01)
        edges = scene.edges(noise=1.0, wild=0.2, seed=seed)
        clean = scene.fit(scene.edges(noise=1.0, seed=seed))
        found = scene.fit(edges)
        sigma = np.sqrt(np.diag(np.linalg.inv(clean.information + scene.root.T @ scene.root)))
        worst = max(worst, float(np.abs((found.u - clean.u) / sigma).max()))
        far = np.abs(found.r) > 4.0 / SIGMA / 2.0
        assert far.sum() >= 3
        light = max(light, float(found.weight[far].max()))
    assert worst < 3.0
    assert light < 0.25


def test_least_squares_would_have_been_carried_away():
    scene = Scene("two_finger", "perspective", 0, off=0.01)
    edges = scene.edges(noise=1.0, wild=0.2)
    found = scene.fit(edges)
    evidence = rows(scene.on[0], edges[0], scene.samplers[0].side)
    r, J = evidence.residual(found.u)
    step = np.linalg.solve(J.T @ J + scene.root.T @ scene.root, J.T @ r)
    assert np.abs(step).max() > 5.0 * np.abs(found.u - scene.u).max()


@pytest.mark.parametrize("plain", [False, True])
def test_limits_hold_where_the_edges_lie_beyond_them(plain):
    scene = Scene("two_finger", "orthographic", 4)
    low, high = scene.model.limits.T
    scene.u = np.where(np.arange(6) % 2, high + 0.1, low - 0.1)  # edges of a pose that is not allowed
    pills = pose_pills(scene.model, forward(scene.model, scene.q), scene.on[0].camera)
    scene.samplers = [place_outline(pills, scene.on[0].camera, scene.model.link_is_tip)]
    scene.mean = np.clip(scene.u, low, high)
    found = scene.fit(scene.edges(), plain=plain)
    assert (found.u >= low - 1e-12).all()
    assert (found.u <= high + 1e-12).all()
    assert ((found.u <= low + 1e-9) | (found.u >= high - 1e-9)).sum() >= 3


def test_a_start_outside_the_limits_is_brought_inside():
    scene = Scene("two_finger")
    low = scene.model.limits[:, 0]
    start = np.where(np.arange(6) == 1, low - 0.2, scene.mean)
    found = scene.fit(scene.edges(), start=start)
    assert (found.u >= low).all()
    np.testing.assert_allclose(found.u, scene.fit(scene.edges()).u, atol=1e-3)


SOLVERS: tuple[Solver, ...] = ("gauss-newton", "damped", "trust-region")


@pytest.mark.parametrize("solver", SOLVERS)
def test_other_solvers_reach_the_same_pose_on_good_edges(solver: Solver):
    scene = Scene("two_finger", "perspective", 5)
    edges = scene.edges(noise=0.3)
    wanted = scene.fit(edges)
    sigma = np.sqrt(np.diag(np.linalg.inv(wanted.information + scene.root.T @ scene.root)))
    np.testing.assert_allclose(scene.fit(edges, solver).u / sigma, wanted.u / sigma, atol=0.3)


def test_the_single_step_of_the_thesis_goes_only_part_of_the_way():
    scene = Scene("two_finger", "perspective", 5)
    edges = scene.edges()
    one = scene.fit(edges, "gauss-newton-one", rescale=False)
    before, after = np.abs(scene.mean - scene.u).max(), np.abs(one.u - scene.fit(edges).u).max()
    assert 1e-4 < after < 0.6 * before


def test_the_stated_covariance_is_that_of_many_noisy_looks():
    scene = Scene("two_finger", "perspective", 6, off=0.0)
    prior = scene.root.T @ scene.root
    errors, squared = [], []
    for seed in range(150):
        rng = np.random.default_rng(1000 + seed)
        scene.mean = scene.u + 0.05 * rng.normal(size=6)
        found = scene.fit(scene.edges(noise=1.0, seed=seed), scatter=Scatter(1.0, 1e-6, np.ones(2), np.eye(2)))
        inside = ((found.u > scene.model.limits[:, 0]) & (found.u < scene.model.limits[:, 1])).all()
        error = found.u - scene.u
        if inside:
            errors.append(error)
            squared.append(error @ (found.information + prior) @ error)
    assert len(squared) > 100
    assert 0.75 * 6 < np.mean(squared) < 1.25 * 6
    assert np.abs(np.mean(errors, axis=0)).max() < 0.1 * np.std(errors, axis=0).max() + 1e-3


def test_edges_that_scatter_more_than_claimed_are_worth_less():
    scene = Scene("two_finger", "perspective", 7)
    calm, wild = (scene.fit(scene.edges(noise=noise, seed=1)) for noise in (1.0, 4.0))
    assert calm.spread < 1.3
    assert 2.5 < wild.spread < 5.5
    ratio = np.trace(calm.information) / np.trace(wild.information)
    assert ratio == pytest.approx((wild.spread / calm.spread) ** 2, rel=0.2)


def test_a_second_fit_forgets_the_scale_of_a_bad_start():
    scene = Scene("two_finger", "perspective", 8, off=0.06)
    edges = scene.edges(noise=1.0, wild=0.2, seed=3)
    once, twice = (scene.fit(edges, rescale=rescale) for rescale in (False, True))
    error = [np.abs(each.u - scene.u).max() for each in (once, twice)]
    assert error[1] < error[0]
