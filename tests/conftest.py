"""Shapes and types are checked while the tests run: jaxtyping's hook with beartype on every module but the kernels.

The hook decorates each function beneath its other decorators, which numba cannot compile; so modules are named one by
one and `_kernels` is left out (its NumPy twins are checked).
"""

import os
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

from jaxtyping import install_import_hook

ROOT = Path(__file__).resolve().parent.parent
UNCHECKED = {"__init__", "_kernels"}


def _checked_modules() -> list[str]:
    files = [file for package in ("handtrack", "synth") for file in sorted((ROOT / package).rglob("*.py"))]
    return [
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in files
        if not UNCHECKED & {file.stem, file.parent.name}
    ]


install_import_hook(_checked_modules(), "beartype.beartype")
