"""A number of repeats in, times of a step of the walk's filters out, with 1200 and with 12 000 particles.

Particles are those of the fusion and of the five postures together: 200 + 5 x 200 in the walk paper, which takes 100 ms
for them (section IV-A: 10 Hz online).
"""

import numpy as np

from synth.walk import WalkSettings, make_walk

from ..body.suit_body import body_of_walk
from ..body.walk_run import follow_walk
from ..body.walk_settings import Settings
from .timings import Timing

FPS = 5.0
SMALL, LARGE = 200, 2000
WARM = 10  # frames that do not count


def walk(repeats: int) -> list[Timing]:
    """A step of Drift-FF with few and with many particles, and one of the error-state filter."""
    scene = make_walk(1, WalkSettings(seconds=(WARM + max(repeats, 10)) / FPS))
    body = body_of_walk(scene.walk)

    def step(settings: Settings) -> float:
        return 1e3 * float(np.median(follow_walk(scene.walk, body, settings, 1).seconds[WARM:]))

    return [
        *(
            Timing(
                f"walk, Drift-FF, {count} + 5 x {count} particles",
                step(Settings(method="drift-ff", particles=count, part_particles=count)),
            )
            for count in (SMALL, LARGE)
        ),
        Timing("walk, error-state filter", step(Settings(method="eskf"))),
    ]
