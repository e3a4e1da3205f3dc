"""Stories of keypoints: the compiled step does what its plain twin does, and what the model says."""

import numpy as np
import pytest

from handtrack._kernels.people import hypotheses_step
from handtrack.body.permanence import MOTION, RULES, SLACK, SYSTEMATIC, no_stories, robust_step
from handtrack.body.resting import PARENT
from handtrack.body.stories_numpy import hypotheses_step_numpy

DT = 1.0 / 30.0


def frames(seed: int, q: int, f: int):
    """Walking skeletons with holes, jumps and wrong sides."""
    rng = np.random.default_rng(seed)
    base = rng.normal(0.0, 0.4, (q, 12, 3)) + np.array([0.0, 0.0, 2.0])
    for n in range(f):
        z = base + np.array([0.02 * n, 0.0, 0.0]) + rng.normal(0.0, 0.02, base.shape)
        z += rng.normal(0.0, 0.6, base.shape) * (rng.random((q, 12, 1)) < 0.2)
        z[rng.random((q, 12)) < 0.25] = np.nan
        yield z, rng.uniform(0.1, 0.9, (q, 12))


@pytest.mark.parametrize("seed", range(6))
def test_the_compiled_step_does_what_its_twin_does(seed):
    rng = np.random.default_rng([seed, 7])
    q, n = 3, 6
    stories = no_stories(q, n)
    ours = [stories.x, stories.v, stories.c, stories.weight, stories.outlier, stories.last]
    plain = [array.copy() for array in ours]
    length = rng.uniform(0.2, 0.5, (q, 12))
    length[0, :4] = np.nan
    rest = rng.normal(0.0, 0.2, (q, 12, 3))
    found = [np.full((q, 12, 3), np.nan), np.zeros((q, 12, 3, 3)), np.zeros((q, 12))]
    twin = [array.copy() for array in found]
    for z, confidence in frames(seed, q, 12):
        r = rng.uniform(1e-4, 5e-3, (q, 12, 2))
        drift = rng.normal(0.0, 0.3, (q, 3))
        more = (z, 14.0 * (confidence - 0.4), r, DT, drift, MOTION, PARENT, length, rest, SLACK, RULES)
        for one, arrays in ((hypotheses_step, (*ours, *more, *found)), (hypotheses_step_numpy, (*plain, *more, *twin))):
            one(*arrays)
        used = ours[3] > 0
        np.testing.assert_array_equal(used, plain[3] > 0)
        for a, b in zip([a[used] for a in ours[:5]], [b[used] for b in plain[:5]], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)
        for a, b in zip([ours[5], *found], [plain[5], *twin], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)


def stood(frames: int, q: int = 1) -> tuple:
    """A wrist seen at one place for some frames: its stories, and the estimate."""
    stories, z = no_stories(q, 8), np.full((q, 12, 3), np.nan)
    z[:, 1], z[:, 3], z[:, 5] = (-0.2, 0.0, 2.0), (-0.2, 0.3, 2.0), (-0.2, 0.5, 1.9)
    length, rest = np.full((q, 12), np.nan), np.zeros((q, 12, 3))
    found = None
    for _ in range(frames):
        stories, found = robust_step(stories, z, np.full((q, 12), 0.65), DT, np.zeros((q, 3)), length, rest)
    return stories, found, z, length, rest


def step(stories, z, confidence, length, rest):
    return robust_step(stories, z, np.full(z.shape[:2], confidence), DT, np.zeros((z.shape[0], 3)), length, rest)


def test_covariance_grows_while_hidden_and_is_bounded():
    stories, found, z, length, rest = stood(30)
    sizes = [np.trace(found.covariance[0, 5])]
    for _ in range(300):
        stories, found = step(stories, np.full_like(z, np.nan), 0.0, length, rest)
        sizes.append(np.trace(found.covariance[0, 5]))
    assert (np.diff(sizes) >= -1e-12).all()
    assert 3 * 0.2**2 < sizes[-1] <= 3 * MOTION[5, 2] ** 2 + np.trace(SYSTEMATIC) + 1e-9
    assert np.linalg.norm(found.p[0, 5] - z[0, 5]) < 0.02


def test_one_wild_measurement_is_not_believed_and_a_lasting_sure_one_is():
    stories, _, z, length, rest = stood(30)
    wild = z.copy()
    wild[0, 5] += (0.0, 0.0, 1.0)
    once, found = step(stories, wild, 0.5, length, rest)
    assert found.believed[0, 5] < 0.5 < found.believed[0, 3]
    assert np.linalg.norm(found.p[0, 5] - z[0, 5]) < 0.15
    for _ in range(15):
        once, found = step(once, wild, 0.7, length, rest)
    assert found.believed[0, 5] > 0.9
    assert np.linalg.norm(found.p[0, 5] - wild[0, 5]) < 0.05


def test_an_outlier_that_stays_where_it_was_proves_nothing():
    """Wrong readings last: a table in front of a knee is read again and again, and is unsure every time."""
    stories, _, z, length, rest = stood(30)
    wild = z.copy()
    wild[0, 5] += (0.0, 0.0, -0.7)
    for _ in range(60):
        stories, found = step(stories, wild, 0.25, length, rest)
    assert found.believed[0, 5] < 0.5
    off = found.p[0, 5] - z[0, 5]
    assert off @ np.linalg.solve(found.covariance[0, 5], off) < 7.8


def test_a_joint_never_seen_is_where_its_bone_puts_it():
    _, _, z, length, rest = stood(1)
    length[:] = 0.3
    rest[0, 3] = 0.0, 0.3, 0.0
    only = np.full_like(z, np.nan)
    only[0, 1] = z[0, 1]
    _, found = step(no_stories(1, 8), only, 0.7, length, rest)
    np.testing.assert_allclose(found.p[0, 3], z[0, 1] + (0.0, 0.3, 0.0), atol=1e-6)
    assert np.sqrt(found.covariance[0, 3, 0, 0]) > 0.15
    assert found.believed[0, 3] == 0.0


def test_what_is_never_seen_and_hangs_on_nothing_stays_unknown():
    stories, z = no_stories(2, 8), np.full((2, 12, 3), np.nan)
    _, found = step(stories, z, 0.0, np.full((2, 12), 0.3), np.zeros((2, 12, 3)))
    assert np.isnan(found.p).all() and np.isnan(found.covariance).all() and not found.believed.any()


def test_bones_keep_their_length_while_a_joint_is_hidden():
    stories, _, z, length, rest = stood(40)
    length[0, 5] = np.linalg.norm(z[0, 5] - z[0, 3])
    for _ in range(60):
        z[0, 1:4:2] += (0.01, 0.0, 0.0)
        hidden = z.copy()
        hidden[0, 5] = np.nan
        stories, found = step(stories, hidden, 0.65, length, rest)
    assert abs(np.linalg.norm(found.p[0, 5] - found.p[0, 3]) - length[0, 5]) < 0.06
    assert found.p[0, 5, 0] > z[0, 5, 0] + 0.3
