"""Articulated finger tracking: images in, poses with their uncertainty out.

`__init__.pyi` lists the names; they are loaded when they are first used, so that the command line starts at once. Two
verbs share their name with a module: `from handtrack.tracker import track`, `from handtrack.evaluate import evaluate`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
