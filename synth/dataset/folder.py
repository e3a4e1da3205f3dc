"""Labelled images of a sequence in, the files of its folder out, as `handtrack track` reads them.

    sequence_000000/sequence.yaml  model.yaml  truth.csv       what a tracker needs, and the truth
    sequence_000000/frames/000000.png ...
    sequence_000000/depth/000000.png ...     and normal/, part/, flow/, labels/000000.json: as in `encode`

Files of frames come from images, those that describe the sequence from its shots alone: the two may be written by
different units of work.
"""

from collections.abc import Sequence
from dataclasses import replace

from handtrack.formats.cameras import cameras_text
from handtrack.formats.model_writing import model_text
from handtrack.formats.poses import code_units

from ..labels.labelled import Labelled
from ..labels.shot import Shot
from ..sequence import truth_text
from .encode import Labels, encoded
from .free_model import tracked

Files = tuple[tuple[str, bytes], ...]


def folder_name(sequence: int) -> str:
    """Folder of a sequence.

    >>> folder_name(7)
    'sequence_000007'
    """
    return f"sequence_{sequence:06d}"


def frame_files(labelled: Labelled, labels: Labels, seed: int | None = None) -> Files:
    """Names and contents of the files of one frame; the picture is a PNG whatever `labels` says."""
    sample = encoded(labelled, replace(labels, image="png"), seed)
    names = dict(frame_names(labelled.sequence, labelled.frame))
    return tuple((names[extension], content) for extension, content in sample.files)


def frame_names(sequence: int, frame: int) -> tuple[tuple[str, str], ...]:
    """Extension in a sample, and name in the folder, of every file that a frame can have.

    >>> frame_names(0, 3)[0]
    ('image.png', 'sequence_000000/frames/000003.png')
    """
    start, number = folder_name(sequence), f"{frame:06d}"
    labels = ("depth", "normal", "part", "flow")
    return (
        ("image.png", f"{start}/frames/{number}.png"),
        *((f"{label}.png", f"{start}/{label}/{number}.png") for label in labels),
        ("json", f"{start}/labels/{number}.json"),
    )


def description_files(shots: Sequence[Shot], fps: float) -> Files:
    """Names and contents of the files that describe a sequence: its frames, camera, model, start and truth.

    The model is that of the first hand; on a hand whose wrist moves it has six more joints, see `free_model`. A
    sequence without a hand has none of these files.

    Parameters
    ----------
    shots : sequence of Shot
        All frames, in order.
    """
    hand = tracked(shots)
    if hand is None:
        return ()
    folder, model = folder_name(shots[0].sequence), hand.model
    units = code_units(model)
    start = ", ".join(f"{model.joint_names[k]}: {hand.q[0, k] / units[k]:.10g}" for k in model.free.tolist())
    text = (
        f"format: handtrack/sequence-1\nfps: {fps:g}\nframes: frames/*.png\n{cameras_text([hand.camera])}"
        f"model: model.yaml\nstart: {{{start}}}\ntruth: truth.csv\n"
    )
    files = {"sequence.yaml": text, "model.yaml": model_text(model), "truth.csv": truth_text(model, hand.q)}
    return tuple((f"{folder}/{name}", content.encode("utf-8")) for name, content in files.items())
