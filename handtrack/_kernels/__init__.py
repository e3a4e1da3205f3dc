"""The few compiled loops. Each has a plain NumPy twin, named in its docstring, that a test compares it with.

Kernels take and return arrays only, never allocate per point, and run in one thread: with a busy core, numba's thread
layer stalls kernels of this size for milliseconds.
"""

from .edges import refine_shift as refine_shift
from .edges import search_valleys as search_valleys
from .edges import wssd as wssd
from .fitting import fit_outline as fit_outline
from .geometry import cast_rays as cast_rays
from .geometry import forward as forward
from .geometry import hit_pill as hit_pill
from .geometry import hit_sphere as hit_sphere
from .pixels import pixel_rows as pixel_rows
from .placing import place_outline as place_outline
from .profiles import expect_profiles as expect_profiles
from .profiles import fill_harmonics as fill_harmonics
from .profiles import sample_lines as sample_lines
from .profiles import shade as shade
from .residuals import outline_rows as outline_rows
from .residuals import soften_rows as soften_rows
from .residuals import whiten_rows as whiten_rows
from .soft_image import soft_image as soft_image
from .width import link_widths as link_widths
from .width import opposite_edges as opposite_edges
from .width import profile_widths as profile_widths
