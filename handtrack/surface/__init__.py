"""A skinned hand surface as the model's shape, driven by the same Denavit-Hartenberg tree."""

from .binding import bind as bind
from .binding import drives_by_name as drives_by_name
from .skin import Skin as Skin
from .skin import Surface as Surface
from .skin import pose_skin as pose_skin
