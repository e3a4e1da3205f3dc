"""Images of a hand in, the time of one look and fit in plain NumPy out: the yardstick for tracking a frame.

The same stages as `handtrack.measure.look` and `handtrack.fit.fit`, each by the twin of its compiled kernel. Tracking a
frame takes one to four such rounds, and learns, filters and refines besides.
"""

import numpy as np

from synth.scenes import Scene

from ..appearance import learn
from ..edges import FOUND
from ..edges.wssd import find_edges_numpy
from ..fit import Fit, fit_numpy
from ..measure import LEAST_REACH, posed_numpy, predicted_spread_numpy
from ..profiles import place_outline_numpy, sample_numpy
from ..residuals import Chain, chain, outline_residuals_numpy, rows, turned_rays_numpy
from ..scatter import first_scatter, whitener
from ..settings import Settings
from ..templates import expect_numpy, positions

_SPREAD = np.radians(1.0)  # of every joint about where the look begins


class PlainRound:
    """One look and fit by the plain twins, at the true pose of the first frame; call it to run it."""

    def __init__(self, scene: Scene, image: np.ndarray, settings: Settings):
        self.on: Chain = chain(scene.model, scene.camera)
        self.u, self.image, self.settings = scene.truth[0][scene.model.free], image, settings
        self.appearance = learn(image, posed_numpy(self.on, self.u), scene.camera)

    def __call__(self) -> Fit:
        on, u, its = self.on, self.u, self.appearance
        covariance = _SPREAD**2 * np.eye(u.size)
        pills = posed_numpy(on, u)
        samplers = place_outline_numpy(pills, on.camera, on.model.link_is_tip, self.settings.spacing, 16)
        spread = predicted_spread_numpy(on, samplers, u, covariance)
        reach = np.maximum(3.0 * spread + 1.0, LEAST_REACH)
        templates = expect_numpy(samplers, pills, on.model.link_finger, on.camera, its, 10.0, 5.0, 0.5)
        margin = float(np.ceil(2.0 * reach.max())) / 2.0
        profiles = sample_numpy(self.image, samplers, positions(10.0 + margin, 5.0 + margin, 0.5))
        edges = find_edges_numpy(samplers, templates, profiles, reach, spread + 0.5, its.noise, its.spread)
        found = edges.reason == FOUND
        features = turned_rays_numpy(
            on.camera, samplers.ray, samplers.slope, edges.offset, found, samplers.link, edges.sigma
        )
        evidence = rows(on, features, samplers.side[found])
        evidence = type(evidence)(lambda v: outline_residuals_numpy(on, features, v), evidence.sigma, evidence.group)
        white = whitener(evidence.sigma, evidence.group, first_scatter())
        root = np.eye(u.size) / _SPREAD
        return fit_numpy(on, evidence, white, u, u, root, self.settings, True)
