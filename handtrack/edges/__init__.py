"""Edge search: profiles in, edge points with sigma and a reason code out; one file for each method."""

from .crossings import Crossings as Crossings
from .derivative import difference as difference
from .derivative import gaussian as gaussian
from .points import BORDER as BORDER
from .points import FLAT as FLAT
from .points import FOUND as FOUND
from .points import HIDDEN as HIDDEN
from .points import JOINT as JOINT
from .points import MISFIT as MISFIT
from .points import OUTSIDE as OUTSIDE
from .points import REASONS as REASONS
from .points import EdgePoints as EdgePoints
from .rectilinear import mwplls as mwplls
from .rectilinear import mwplls_iterative as mwplls_iterative
from .rectilinear import plls as plls
from .width_restricted import width as width
from .width_restricted import width_compensated as width_compensated
from .wssd import curves as curves
from .wssd import find_edges as find_edges
