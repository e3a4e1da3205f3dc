"""Couplings: exact ones as a linear map, soft ones as normal priors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import orthographic
from handtrack.estimate import Prior, prior_of
from handtrack.kinematics import Coupling, FrameRow, model_from_rows, pose_from_free
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.kinematics.couplings import coupling_matrix, soft_rows
from handtrack.residuals import chain
from handtrack.smooth import start

NAMES = ("a", "b", "c", "d")
numbers = st.floats(-3.0, 3.0)


def rows_of(couplings: list[Coupling]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    _, matrix, offset = coupling_matrix(NAMES, couplings)
    return matrix, offset, *soft_rows(NAMES, couplings, matrix, offset)


@given(numbers, numbers, st.floats(0.01, 3.0), numbers, numbers, st.tuples(numbers, numbers, numbers))
@settings(max_examples=60, deadline=None)
def test_soft_rows_measure_the_difference_of_all_joints_in_sigmas(ratio, offset, sigma, gain, shift, u):
    couplings = [Coupling("d", "c", gain, shift), Coupling("b", "d", ratio, offset, sigma)]
    matrix, constant, rows, targets = rows_of(couplings)
    q = matrix @ np.array(u) + constant
    difference = q[1] - ratio * q[3] - offset
    np.testing.assert_allclose(rows @ np.array(u) - targets, [difference / sigma], atol=1e-9 / sigma)


def test_soft_couplings_take_no_freedom_away():
    free, matrix, offset = coupling_matrix(NAMES, [Coupling("b", "a", 0.5, sigma=0.1), Coupling("d", "c", 2.0)])
    assert free.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(matrix, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 2]])
    assert not offset.any()


def test_one_joint_may_follow_two_others_softly():
    _, _, rows, _ = rows_of([Coupling("c", "a", 1.0, sigma=1.0), Coupling("c", "b", 1.0, sigma=0.5)])
    np.testing.assert_array_equal(rows, [[-1, 0, 1, 0], [0, -2, 2, 0]])


@pytest.mark.parametrize(
    ("couplings", "message"),
    [
        ([Coupling("b", "a", 0.5, sigma=0.0)], "sigma of joint 'b' is 0.0; a finite one > 0 is wanted"),
        ([Coupling("b", "a", 0.5, sigma=-1.0)], "sigma of joint 'b' is -1.0"),
        ([Coupling("b", "a", 0.5, sigma=np.inf)], "sigma of joint 'b' is inf"),
        ([Coupling("b", "a", 0.5, sigma=1.0), Coupling("b", "a", 0.6, sigma=1.0)], "'b' follows 'a' twice"),
        ([Coupling("b", "a", 0.5), Coupling("b", "a", 0.5, sigma=1.0)], "'b' follows 'a' exactly; no sigma"),
        ([Coupling("a", "a", 0.5, sigma=1.0)], "'a' follows itself in a circle"),
        ([Coupling("a", "b", 0.5, sigma=1.0), Coupling("b", "a", 2.0, sigma=1.0)], "follows itself in a circle"),
        ([Coupling("d", "a", 1.0), Coupling("a", "b", 0.5), Coupling("b", "a", 2.0)], "'[ab]' follows itself"),
        ([Coupling("b", "z", 0.5, sigma=1.0)], "joint 'z' does not exist; the model has a, b, c, d"),
    ],
)
def test_couplings_that_say_nothing_or_circle_are_refused(couplings, message):
    with pytest.raises(ValueError, match=message):
        rows_of(couplings)


def test_a_model_keeps_its_soft_couplings_beside_the_exact_ones():
    joints = [FrameRow(i + 1, i, a=1.0, joint=name) for i, name in enumerate(NAMES)]
    soft = Coupling("b", "a", 0.5, 0.2, sigma=0.1)
    chain = model_from_rows("chain", joints, [soft, Coupling("d", "c", 2.0)])
    assert chain.soft_couplings == (soft,)
    u = np.array([1.0, 0.9, 0.3])
    np.testing.assert_allclose(chain.soft @ u - chain.soft_target, [2.0])
    np.testing.assert_allclose(pose_from_free(chain, u), [1.0, 0.9, 0.3, 0.6])
    assert model_from_rows("free", joints).soft.shape == (0, 4)


def hidden_dip(sigma_of_prediction: float) -> tuple[np.ndarray, Prior]:
    """What prediction and soft coupling make of an index finger whose PIP is known and whose DIP may not be."""
    hand = replace(
        builtin_model("index"),
        soft=np.array([[0.0, -2.0 / 3.0, 1.0]]) / np.radians(15.0),
        soft_target=np.zeros(1),
    )
    camera = orthographic(64, 48, 3.0, 32.0, 24.0, np.eye(3), np.zeros(3))
    q = np.radians([10.0, 60.0, 0.0])
    sigma = np.radians([0.2, 0.2, sigma_of_prediction])
    motion = start(q, np.diag(sigma**2), sigma_velocity=1.0)
    return q, prior_of(chain(hand, camera), motion)


def test_a_joint_that_nothing_tells_of_follows_its_soft_coupling():
    _, prior = hidden_dip(sigma_of_prediction=500.0)
    np.testing.assert_allclose(np.degrees(prior.mean), [10.0, 60.0, 40.0], atol=0.1)
    assert np.degrees(np.sqrt(prior.covariance[2, 2])) == pytest.approx(15.0, abs=0.02)
    np.testing.assert_allclose(prior.covariance @ prior.information, np.eye(3), atol=1e-9)


def test_a_joint_that_is_known_outweighs_its_soft_coupling():
    q, prior = hidden_dip(sigma_of_prediction=0.3)
    np.testing.assert_allclose(np.degrees(prior.mean - q), 0.0, atol=0.02)
