"""What tracking returns: for every frame a pose, how sure it is, and what it rests on."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped

TRACKED, UNCERTAIN, LOST = "tracked", "uncertain", "lost"


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Poses over time, radians (model units for prismatic joints).

    Attributes
    ----------
    joint_names : tuple of str
        Order of the joints in every array here.
    frame, time : (n,)
        Frame number and time in seconds.
    q, sigma, covariance : (n, j), (n, j), (n, j, j)
        Estimated joint values with their standard deviations and covariance.
    information : (n, k, k)
        What the images alone say of the independent joints, 1/radian^2; zero where they say nothing.
    status : (n,)
        'tracked', 'uncertain' or 'lost'.
    confidence : (n,)
        0 to 1.
    residual : (n,)
        Root mean square distance of the accepted edge points from the model's outline, pixels.
    visible : (n, l)
        Visible share of each link, 0 to 1.
    edges : (n,)
        Number of accepted edge points.
    seconds : (n,)
        Computing time of the frame, image reading apart.
    view_edges, view_visible : (n, v), (n, v, l) or None
        Accepted edge points and visible share of each link in each view; None for a track that does not say.
    rival, rival_weight : (n, j), (n,) or None
        Another pose that the images so far could not tell from `q`, NaN where there is none, and its weight, 0 to 1;
        its distance from q is in the covariance. None for a track that does not say.
    width, width_sigma, width_lasting, width_profiles : (n, l) or None
        Measured width in the middle of each link with its standard deviation, the part of that which is the same in
        all frames, and the number of profiles with both edges; width 0 and sigma inf where there is none (see
        `handtrack.width`). None for a track that does not say.
    """

    joint_names: tuple[str, ...]
    frame: Int[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n j"]
    sigma: Float[np.ndarray, "n j"]
    covariance: Float[np.ndarray, "n j j"]
    information: Float[np.ndarray, "n k k"]
    status: Shaped[np.ndarray, " n"]
    confidence: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    visible: Float[np.ndarray, "n l"]
    edges: Int[np.ndarray, " n"]
    seconds: Float[np.ndarray, " n"]
    view_edges: Int[np.ndarray, "n v"] | None = None
    view_visible: Float[np.ndarray, "n v l"] | None = None
    rival: Float[np.ndarray, "n j"] | None = None
    rival_weight: Float[np.ndarray, " n"] | None = None
    width: Float[np.ndarray, "n l"] | None = None
    width_sigma: Float[np.ndarray, "n l"] | None = None
    width_lasting: Float[np.ndarray, "n l"] | None = None
    width_profiles: Int[np.ndarray, "n l"] | None = None
