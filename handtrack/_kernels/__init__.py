"""The few compiled loops. Each has a plain NumPy twin, named in its docstring, that a test compares it with.

Kernels take and return arrays only, never allocate per point, and run in one thread: with a busy core, numba's thread
layer stalls kernels of this size for milliseconds.
"""

from .bvh import build_tree as build_tree
from .bvh import first_hits as first_hits
from .bvh import within as within
from .depth import nearest_readings as nearest_readings
from .depth import seen_through as seen_through
from .edges import find_edges as find_edges
from .edges import refine_shift as refine_shift
from .edges import search_valleys as search_valleys
from .edges import wssd as wssd
from .fitting import fit_frame as fit_frame
from .fitting import fit_outline as fit_outline
from .folding import screen_folds as screen_folds
from .geometry import cast_rays as cast_rays
from .geometry import forward as forward
from .geometry import hit_pill as hit_pill
from .geometry import hit_sphere as hit_sphere
from .geometry import pose_links as pose_links
from .learning import fill_shading as fill_shading
from .learning import find_light as find_light
from .learning import second_differences as second_differences
from .learning import surface_points as surface_points
from .limbs import limb_lengths as limb_lengths
from .limbs import limb_rays as limb_rays
from .limbs import outside_wedge as outside_wedge
from .placing import count_samplers as count_samplers
from .placing import place_outline as place_outline
from .posture import chain_frames as chain_frames
from .posture import points_on as points_on
from .posture import segment_misfits as segment_misfits
from .profiles import fill_harmonics as fill_harmonics
from .profiles import sample_lines as sample_lines
from .profiles import shade as shade
from .reading import read_patches as read_patches
from .residuals import outline_rows as outline_rows
from .residuals import outline_spread as outline_spread
from .residuals import soften_rows as soften_rows
from .residuals import turn_rays as turn_rays
from .residuals import whiten_rows as whiten_rows
from .scattering import scatter_moments as scatter_moments
from .scattering import shape_columns as shape_columns
from .soft_image import soft_image as soft_image
from .soft_rows import choose_samples as choose_samples
from .soft_rows import normal_equations as normal_equations
from .soft_rows import sample_rows as sample_rows
from .templates import depth_steps as depth_steps
from .templates import expect_profiles as expect_profiles
from .width import link_widths as link_widths
from .width import opposite_edges as opposite_edges
from .width import profile_widths as profile_widths
