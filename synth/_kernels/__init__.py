"""The compiled loops of the renderers; each has a plain NumPy twin, or an independent oracle, that a test compares."""

from .mesh import render_samples as render_samples
from .pills import BINARY as BINARY
from .pills import FLAT as FLAT
from .pills import GAUSS as GAUSS
from .pills import GOURAUD as GOURAUD
from .pills import HALVINGS as HALVINGS
from .pills import LATTICE as LATTICE
from .pills import PHONG as PHONG
from .pills import REACH as REACH
from .pills import STRIDE as STRIDE
from .pills import TIE as TIE
from .pills import cast_pixels as cast_pixels
from .pills import covered as covered
from .pills import crossing as crossing
from .pills import facet_light as facet_light
from .pills import facet_place as facet_place
from .pills import integrate as integrate
from .pills import key_pixels as key_pixels
from .pills import normal_pixels as normal_pixels
from .pills import pill_depth as pill_depth
from .pills import pill_normal as pill_normal
from .pills import point_light as point_light
from .pills import power as power
from .pills import scatter as scatter
from .pills import shade_pixels as shade_pixels
from .pills import surface_light as surface_light
