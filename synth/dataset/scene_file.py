"""A scene file in, a checked description of all images that it may give out."""

from dataclasses import dataclass
from pathlib import Path

from handtrack.errors import InputError
from handtrack.formats.paths import inside
from handtrack.formats.yaml_files import Document, at, read_yaml, validate
from handtrack.kinematics.builtin import model_names

from .encode import Labels
from .scene_schema import SceneSchema

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """A scene file that has been read.

    Attributes
    ----------
    path : Path
    text : str
        The file as it is.
    schema : SceneSchema
    inputs : tuple of (str, Path)
        Files that the scene refers to, by the names that it uses.
    """

    path: Path
    text: str
    schema: SceneSchema
    inputs: tuple[tuple[str, Path], ...]

    @property
    def labels(self) -> Labels:
        """What is written of each image."""
        image, labels = self.schema.image, self.schema.labels
        return Labels(
            image.type,
            image.quality,
            labels.depth_unit,
            labels.depth,
            labels.normal,
            labels.part,
            labels.flow,
            labels.amodal,
        )

    @property
    def frames(self) -> int:
        """Frames of a sequence."""
        return self.schema.sequence.frames

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self.schema.sequence.fps

    def file(self, name: str) -> Path:
        """The file that the scene calls by a name."""
        return dict(self.inputs)[name]


def read_scene(path: Path | str) -> SceneFile:
    """Read a scene file.

    Raises
    ------
    InputError
        In one line with file, line, place and what was wanted: for a file that is not of this format, unknown keys,
        values out of range, and files that are missing or outside the scene's folder.
    """
    document = read_yaml(Path(path))
    schema = validate(document, SceneSchema)
    inputs: dict[str, Path] = {}
    for place, name in _named(document, schema):
        found, _ = inside(document.path.parent, name, at(document, place))
        if not found.is_file():
            raise InputError(f"{at(document, place)} {name!r} is no file; it is looked for beside the scene file")
        inputs[name] = found
    if schema.background.kind == "images":
        inputs |= _background_images(document, schema)
    return SceneFile(Path(path), Path(path).read_text("utf-8"), schema, tuple(sorted(inputs.items())))


def _named(document: Document, schema: SceneSchema):
    """Places and names of the files that a scene needs, besides background images."""
    for i, hand in enumerate(schema.hands):
        if hand.kind == "mesh" and hand.mesh is not None:
            yield ("hands", i, "mesh"), hand.mesh
        if hand.kind == "pills" and hand.model not in model_names():
            yield ("hands", i, "model"), hand.model
        if hand.pose.type == "file":
            if hand.pose.file is None:
                raise InputError(f"{at(document, ('hands', i, 'pose'))} 'file' is missing")
            yield ("hands", i, "pose", "file"), hand.pose.file
    for i, occluder in enumerate(schema.occluders):
        if occluder.kind == "mesh":
            if occluder.mesh is None:
                raise InputError(f"{at(document, ('occluders', i))} 'mesh' is missing")
            yield ("occluders", i, "mesh"), occluder.mesh


def _background_images(document: Document, schema: SceneSchema) -> dict[str, Path]:
    """Images in the background folder, by name."""
    if schema.background.folder is None:
        raise InputError(f"{at(document, ('background',))} 'folder' is missing")
    place = at(document, ("background", "folder"))
    folder, _ = inside(document.path.parent, schema.background.folder, place)
    if not folder.is_dir():
        raise InputError(f"{place} {schema.background.folder!r} is no folder; it is looked for beside the scene file")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGES)
    if not found:
        raise InputError(f"{place} {schema.background.folder!r} holds no images; wanted some of {', '.join(IMAGES)}")
    return {f"{schema.background.folder}/{path.name}": path for path in found}
