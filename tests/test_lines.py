"""Lines: what fitting, bisecting and refining promise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.lines import Line, axial_line, distance, fit_line, refined_tip


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def line_points(angle: float, rho: float, along: np.ndarray) -> np.ndarray:
    """Points at positions `along` of the line whose direction makes `angle` with x."""
    v, n = rotation(angle).T
    return rho * n + along[:, None] * v


def exact_line(angle: float, rho: float, along: tuple[float, float] = (-20.0, 20.0)) -> Line:
    return fit_line(line_points(angle, rho, np.linspace(*along, 6)), np.full(6, 0.3), tolerance=1.0)


@pytest.mark.parametrize("angle", np.radians([0, 30, 45, 90, 135, 180, -60]))
def test_exact_points_give_the_exact_line(angle):
    line = exact_line(angle, rho=7.0)
    assert line.valid and line.inliers.all()
    np.testing.assert_allclose(line.direction, rotation(angle)[:, 0], atol=1e-12)
    np.testing.assert_allclose(line.normal, rotation(angle)[:, 1], atol=1e-12)
    np.testing.assert_allclose(line.rho, 7.0, atol=1e-12)
    assert np.cos(line.angle - angle) > 1 - 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_up_to_forty_percent_outliers_change_nothing(seed):
    rng = np.random.default_rng(seed)
    points = line_points(rng.uniform(-3, 3), 20.0, np.linspace(0, 50, 10))
    outliers = rng.choice(10, size=4, replace=False)
    clean = fit_line(np.delete(points, outliers, axis=0), np.ones(6), tolerance=0.5)
    moved = points.copy()
    moved[outliers] += clean.normal * (rng.uniform(2, 30, 4) * rng.choice([-1, 1], 4))[:, None]
    line = fit_line(moved, np.ones(10), tolerance=0.5)
    assert set(np.flatnonzero(~line.inliers)) == set(outliers)
    np.testing.assert_allclose(line.direction, clean.direction, atol=1e-12)
    np.testing.assert_allclose(line.rho, clean.rho, atol=1e-11)


def test_inliers_are_those_within_the_tolerance_of_the_pair():
    points = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 0.0], [15.0, 0.49], [15.0, 0.51]])
    line = fit_line(points, np.ones(6), tolerance=0.5)
    assert line.inliers.tolist() == [True, True, True, True, True, False]


def test_precise_points_pull_harder_than_vague_ones():
    points = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [0.0, 1.0], [10.0, 1.0], [20.0, 1.0]])
    line = fit_line(points, np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0]), tolerance=2.0)
    np.testing.assert_allclose(abs(line.rho), 1.0 / 101.0, atol=1e-3)


def test_agrees_with_the_singular_value_decomposition():
    rng = np.random.default_rng(5)
    points = line_points(0.7, 3.0, np.linspace(0, 30, 8)) + rng.normal(0, 0.5, (8, 2))
    line = fit_line(points, np.ones(8), tolerance=np.inf)
    main = np.linalg.svd(points - points.mean(axis=0))[2][0]
    assert abs(main @ line.normal) < 1e-12
    np.testing.assert_allclose(line.centroid, points.mean(axis=0), atol=1e-12)


def test_batch_fits_each_group_as_if_alone_and_skips_padding():
    rng = np.random.default_rng(2)
    points = rng.normal(0, 1, (3, 4, 7, 2)) + np.linspace(0, 40, 7)[:, None]
    sigma = rng.uniform(0.2, 1.0, (3, 4, 7))
    points[1, 2, 5:] = np.nan
    sigma[2, 3, 0] = np.inf
    batch = fit_line(points, sigma, tolerance=1.5)
    for index in np.ndindex(3, 4):
        alone = fit_line(points[index], sigma[index], tolerance=1.5)
        np.testing.assert_allclose(batch.normal[index], alone.normal, atol=1e-13)
        np.testing.assert_allclose(batch.covariance[index], alone.covariance, atol=1e-13)
        np.testing.assert_array_equal(batch.inliers[index], alone.inliers)
    np.testing.assert_array_equal(batch[:, 1].rho, batch.rho[:, 1])
    short = fit_line(points[1, 2, :5], sigma[1, 2, :5], tolerance=1.5)
    np.testing.assert_allclose(batch.rho[1, 2], short.rho, atol=1e-12)
    assert not batch.inliers[1, 2, 5:].any() and not batch.inliers[2, 3, 0]


@pytest.mark.parametrize(
    ("points", "status"),
    [
        (np.zeros((0, 2)), "few points"),
        (np.zeros((1, 2)), "few points"),
        (np.full((4, 2), 3.0), "few points"),
        (np.full((4, 2), np.nan), "few points"),
        (np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), "no direction"),
    ],
)
def test_points_without_a_direction_are_told_by_the_status(points, status):
    line = fit_line(points, np.ones(len(points)), tolerance=5.0)
    assert line.status == status and not line.valid
    assert np.isnan(line.rho) and np.isnan(line.covariance).all()
    both = axial_line(exact_line(0.0, 3.0), line)
    assert both.status == status and np.isnan(both.normal).all()
    assert np.isnan(refined_tip(np.zeros(2), both)).all()


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="tolerance is 0"):
        fit_line(np.zeros((3, 2)), np.ones(3), tolerance=0.0)
    with pytest.raises(ValueError, match="tolerance is nan"):
        fit_line(np.zeros((3, 2)), np.ones(3), tolerance=float("nan"))
    with pytest.raises(ValueError, match="sigma holds -1"):
        fit_line(np.zeros((3, 2)), np.array([1.0, -1.0, 1.0]), tolerance=1.0)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    turn=st.floats(-np.pi, np.pi),
    shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
def test_moving_the_points_moves_the_lines_with_them(seed, turn, shift):
    rng = np.random.default_rng(seed)
    r, t = rotation(turn), np.array(shift)
    sides = np.stack([line_points(0.1, 8.0, np.linspace(0, 40, 7)), line_points(-0.1, -8.0, np.linspace(0, 40, 7))])
    sides += rng.normal(0, 0.5, sides.shape)
    sigma = rng.uniform(0.3, 1.0, (2, 7))
    here, there = (fit_line(p, sigma, tolerance=1.0) for p in (sides, sides @ r.T + t))
    for a, b in ((here, there), (axial_line(here[0], here[1]), axial_line(there[0], there[1]))):
        np.testing.assert_allclose(b.centroid, a.centroid @ r.T + t, atol=1e-9)
        np.testing.assert_allclose(b.direction, a.direction @ r.T, atol=1e-9)
        np.testing.assert_allclose(b.normal, a.normal @ r.T, atol=1e-9)
        np.testing.assert_allclose(b.rho, a.rho + b.normal @ t, atol=1e-9)
        np.testing.assert_allclose(b.covariance, a.covariance, rtol=1e-6, atol=1e-12)


def errors_of_lines(lines: Line, truth: Line) -> np.ndarray:
    """(runs, 2) of angle and of offset at the centroid of the true line, sign as in the covariance."""
    angle = np.sum(lines.direction * truth.normal, axis=-1)
    offset = np.sum((lines.centroid - truth.centroid) * lines.normal, axis=-1) / np.sum(
        lines.normal * truth.normal, axis=-1
    )
    return np.stack([angle, offset], axis=-1)


def noisy_sides(runs: int, angles: tuple[float, float], flip: bool) -> tuple[list[Line], list[Line]]:
    rng = np.random.default_rng(11)
    fitted, exact = [], []
    for k, (angle, rho) in enumerate(zip(angles, (9.0, -8.0), strict=True)):
        along = np.linspace(0, 45, 8) + 12 * k
        points = line_points(angle, rho, along[::-1] if flip and k else along)
        sigma = np.linspace(0.2, 0.6, 8)
        noise = rng.normal(0, 1, (runs, 8, 1)) * sigma[:, None] * rotation(angle)[:, 1]
        fitted.append(fit_line(points + noise, np.broadcast_to(sigma, (runs, 8)), tolerance=np.inf))
        exact.append(fit_line(points, sigma, tolerance=np.inf))
    return fitted, exact


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("angles", [(0.3, 0.3), (0.3, 0.3001), (0.45, 0.15)])
def test_covariance_is_that_of_repeated_noise(angles, flip):
    fitted, exact = noisy_sides(8000, angles, flip)
    for lines, truth in (*zip(fitted, exact, strict=True), (axial_line(*fitted), axial_line(*exact))):
        measured = np.cov(errors_of_lines(lines, truth).T)
        scale = np.sqrt(np.outer(*[np.diag(truth.covariance)] * 2))
        np.testing.assert_allclose(measured / scale, truth.covariance / scale, atol=0.06)


def test_normalised_errors_are_chi_square():
    fitted, exact = noisy_sides(8000, (0.4, 0.2), flip=True)
    axis, truth = axial_line(*fitted), axial_line(*exact)
    e = errors_of_lines(axis, truth)
    nees = np.sum(e * np.linalg.solve(axis.covariance, e[..., None])[..., 0], axis=-1)
    assert nees.mean() == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("taper", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.4])
def test_axis_of_a_symmetric_link_is_found_at_any_taper(taper):
    centre, turn = np.array([300.0, 200.0]), rotation(0.8)
    axis = axial_line(
        *(
            fit_line(np.stack([s, side * (10 - taper * s)], axis=-1) @ turn.T + centre, np.ones(6), tolerance=1.0)
            for side, s in ((1, np.linspace(0, 30, 6)), (-1, np.linspace(8, 50, 6)))
        )
    )
    np.testing.assert_allclose(axis.direction, turn[:, 0], atol=1e-12)
    np.testing.assert_allclose(axis.rho, axis.normal @ centre, atol=1e-9)
    assert distance(axis, centre[None])[0] == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(
    angle1=st.floats(-3, 3),
    spread=st.floats(-0.7, 0.7),
    rho1=st.floats(-50, 50),
    rho2=st.floats(-50, 50),
    turned=st.booleans(),
)
def test_every_point_of_the_axis_is_equally_far_from_both_sides(angle1, spread, rho1, rho2, turned):
    one, two = exact_line(angle1, rho1), exact_line(angle1 + spread + np.pi * turned, rho2)
    axis = axial_line(one, two)
    x = axis.centroid + np.linspace(-100, 100, 5)[:, None] * axis.direction
    np.testing.assert_allclose(np.abs(distance(one, x)[0]), np.abs(distance(two, x)[0]), atol=1e-9)
    np.testing.assert_allclose(axis.normal @ axis.centroid, axis.rho, atol=1e-9)
    assert abs(axis.direction @ one.direction) >= np.cos(np.pi / 4) - 1e-9
    swapped = axial_line(two, one)
    np.testing.assert_allclose(swapped.rho * np.sign(swapped.normal @ axis.normal), axis.rho, atol=1e-9)


def test_axis_passes_through_the_crossing_of_converging_sides():
    one, two = exact_line(0.3, 4.0), exact_line(-0.2, -6.0)
    crossing = np.linalg.solve(np.stack([one.normal, two.normal]), np.array([one.rho, two.rho]))
    np.testing.assert_allclose(distance(axial_line(one, two), crossing[None])[0], 0.0, atol=1e-9)


def test_sigma_of_the_distance_grows_away_from_the_points():
    line = exact_line(0.5, 3.0)
    sigma = distance(line, line.centroid + np.array([0.0, 20.0, 200.0])[:, None] * line.direction)[1]
    np.testing.assert_allclose(sigma[0], 0.3 / np.sqrt(6), rtol=1e-12)
    assert np.all(np.diff(sigma) > 0)


def test_refined_tip_is_the_nearest_point_of_the_line():
    line, tip = exact_line(0.5, 3.0), np.array([31.0, 12.0])
    refined = refined_tip(tip, line)
    assert distance(line, refined[None])[0] == pytest.approx(0.0, abs=1e-12)
    assert abs((tip - refined) @ line.direction) < 1e-12
