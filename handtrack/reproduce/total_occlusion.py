"""Figures of hidden fingers in, what the hand thesis says of total occlusion beside them out (chapter 7).

The thesis tracks fingers of which a part is always seen, names total occlusion as what its method cannot do, and leaves
confidence and a bank of predictions to future work. It prints no numbers for it, so its column holds its statements.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from .hidden_fingers import PROMPT, Row, frames_text


@dataclass(frozen=True, slots=True)
class Claim:
    """What the thesis says of its method or hopes for, and what ours gives for it.

    Attributes
    ----------
    scene : str
        Name and length of the scene that ours is measured on.
    theirs, ours : str
        Words; and numbers.
    """

    scene: str
    theirs: str
    ours: str


CLAIM_HEADER = ("scene", "theirs, in words", "ours")


def claims(rows: Sequence[Row]) -> list[Claim]:
    """Statements of chapter 7, each held against the rows that it is about."""
    found = []
    for row in rows:
        scene = f"{row.kind} {row.length}"
        if row.kind == "crossing":
            loses = "estimation loses accuracy where a phalange is more than 50 % occluded"
            found.append(Claim(scene, loses, f"error {row.error:.2f} deg while more than 40 % of the finger is"))
            continue
        back = (
            f"found in {PROMPT} frames and not swapped in {row.prompt} of {row.runs} runs, never found in {row.lost}; "
            f"median {frames_text(row.back)}"
        )
        found += [
            Claim(scene, "bound to lose the finger that is hidden", back),
            Claim(scene, "not to be matched with the right finger", f"swapped in {row.swaps} of {row.runs} runs"),
            Claim(
                scene,
                "a measure of confidence is wanted",
                f"error {row.error:.2f} deg, inside two sigmas in {100.0 * row.inside:.0f} % of {row.hidden} frames",
            ),
        ]
    return found


def claim_rows(rows: Sequence[Row]) -> list[list[object]]:
    """The same as rows under `CLAIM_HEADER`."""
    return [[each.scene, each.theirs, each.ours] for each in claims(rows)]


def claims_data(rows: Sequence[Row]) -> list[dict[str, str]]:
    """The same as plain data."""
    return [{"scene": each.scene, "theirs": each.theirs, "ours": each.ours} for each in claims(rows)]
