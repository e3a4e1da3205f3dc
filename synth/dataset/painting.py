"""Random numbers in, the paint of hands and occluders out."""

import numpy as np

from ..labels.solids import TEXTURES, Paint, Parts
from .scene_schema import SceneSchema

SKIN = np.array(  # red, green, blue from light to dark; chosen here
    [
        [244.0, 212.0, 190.0],
        [228.0, 187.0, 158.0],
        [205.0, 157.0, 124.0],
        [170.0, 121.0, 89.0],
        [125.0, 84.0, 58.0],
        [86.0, 58.0, 42.0],
    ]
)
MOTTLED, FRECKLE = 0.86, (5.0, 14.0)  # second tone of skin against the first, and the grain of its texture, mm


def painted(rng: np.random.Generator, parts: Parts, schema: SceneSchema) -> Paint:
    """Paint of all parts: skin for hands, random colours and textures for occluders."""
    count = len(parts.name)
    colour, second = np.empty((count, 3)), np.empty((count, 3))
    texture, grain = np.zeros(count, np.int64), np.ones(count)
    specular, shininess = np.empty(count), np.empty(count)
    allowed = sorted({TEXTURES.index(name) for file in schema.occluders for name in file.textures}) or [0]
    for k, kind in enumerate(parts.kind):
        mine = np.flatnonzero(parts.instance == k)
        if kind.endswith("hand"):
            at = rng.uniform(*schema.hands[min(k, len(schema.hands) - 1)].skin) * (SKIN.shape[0] - 1)
            low = min(int(at), SKIN.shape[0] - 2)
            tone = SKIN[low] + (at - low) * (SKIN[low + 1] - SKIN[low])
            colour[mine] = tone * (1.0 + 0.02 * rng.standard_normal((mine.size, 1)))
            second[mine] = MOTTLED * colour[mine]
            texture[mine], grain[mine] = TEXTURES.index("noise"), rng.uniform(*FRECKLE)
            specular[mine], shininess[mine] = rng.uniform(0.02, 0.12), rng.uniform(6.0, 25.0)
        else:
            colour[mine], second[mine] = rng.uniform(20.0, 245.0, (2, 1, 3))
            texture[mine], grain[mine] = rng.choice(allowed), rng.uniform(4.0, 25.0)
            specular[mine], shininess[mine] = rng.uniform(0.0, 0.4), rng.uniform(5.0, 60.0)
    return Paint(np.clip(colour, 0, 255), np.clip(second, 0, 255), texture, grain, specular, shininess)
