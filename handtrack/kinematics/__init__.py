"""Denavit-Hartenberg trees of fingers, hands, arms and bodies."""

from .couplings import Coupling as Coupling
from .tree import FrameRow as FrameRow
from .tree import LinkSigmas as LinkSigmas
from .tree import Model as Model
from .tree import forward as forward
from .tree import forward_numpy as forward_numpy
from .tree import joints_below as joints_below
from .tree import link_ends as link_ends
from .tree import link_transform as link_transform
from .tree import model_from_rows as model_from_rows
from .tree import point_jacobian as point_jacobian
from .tree import pose_from_free as pose_from_free
