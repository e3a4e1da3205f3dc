"""What `--surface` names in, the surface tied to a sequence's model out, and what a run says of it."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..formats.glb import read_glb
from ..kinematics import Model
from ..settings import Settings
from ..surface import Surface, bind

_PLAIN = ("residuals", "edges", "refine", "templates", "visibility")


@dataclass(frozen=True, slots=True, eq=False)
class Skinned:
    """A bound surface and the file it came from."""

    path: Path
    digest: str
    surface: Surface

    def as_data(self) -> dict[str, object]:
        """What `run.json` keeps: file, checksum, scale and misfit."""
        return {
            "file": self.path.name,
            "sha256": self.digest,
            "scale": round(self.surface.scale, 6),
            "misfit_mm": round(float((self.surface.misfit**2).mean() ** 0.5), 4),
        }


def open_surface(path: Path, model: Model, settings: Settings) -> Skinned:
    """Read a mesh and tie it to the model.

    Raises
    ------
    InputError
        For a file that is no skinned W3C hand, a model of another hand, or settings that are made for pills.
    """
    plain = Settings()
    for name in _PLAIN:
        if getattr(settings, name) != getattr(plain, name):
            raise InputError(f"--{name}: is for pills; none was wanted with --surface")
    mesh = read_glb(path)
    try:
        surface = bind(model, mesh)
    except ValueError as refused:
        raise InputError(f"{path}: {refused}") from refused
    return Skinned(path, hashlib.sha256(path.read_bytes()).hexdigest(), surface)
