"""Edge search: profiles in, edge points with sigma and a reason code out; one file for each method."""

from .points import BORDER as BORDER
from .points import FLAT as FLAT
from .points import FOUND as FOUND
from .points import HIDDEN as HIDDEN
from .points import JOINT as JOINT
from .points import MISFIT as MISFIT
from .points import OUTSIDE as OUTSIDE
from .points import REASONS as REASONS
from .points import EdgePoints as EdgePoints
from .wssd import curves as curves
from .wssd import find_edges as find_edges
