"""Some images of a dataset and its whole index in, one HTML page out that holds everything it shows.

A contact sheet with the labels drawn over each image, and the distributions of occlusion, view, pose and size over all
images. The page loads nothing, and the same input gives the same bytes.
"""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template

from .browse_charts import charts
from .browse_layers import facts, layers
from .decode import Decoded
from .index import Row

_LAYERS = (
    ("base", "image", "image"),
    ("base", "depth", "depth"),
    ("base", "normal", "normals"),
    ("base", "flow", "flow"),
    ("over", "part", "parts"),
    ("over", "amodal", "whole parts"),
    ("over", "box", "boxes"),
    ("over", "point", "keypoints"),
)
_SHOWN_FIRST = ("image", "point")


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """An image to show: its labels, and its colour picture (extension, content) as it was stored."""

    labels: Decoded
    picture: tuple[str, bytes]


def browse_page(title: str, tiles: Sequence[Tile], rows: Sequence[Row]) -> str:
    """The text of the page.

    Parameters
    ----------
    title : str
        Name of the dataset.
    tiles : sequence of Tile
        Images of the contact sheet, in the order in which they are shown.
    rows : sequence of Row
        The index of all images.
    """
    return Template(_asset("browse.html")).substitute(
        title=html.escape(title),
        subtitle=html.escape(_subtitle(tiles, rows)),
        style=_asset("browse.css") + _layer_rules(),
        script=_asset("browse.js"),
        switches="".join(_switch(*layer) for layer in _LAYERS),
        tiles="".join(_tile(tile) for tile in tiles),
        charts="".join(
            f'<section class="card"><h3>{html.escape(chart.title)}</h3>{chart.drawing}'
            f'<p class="facts">{html.escape(chart.facts)}</p></section>'
            for chart in charts(rows)
        ),
    )


def _subtitle(tiles: Sequence[Tile], rows: Sequence[Row]) -> str:
    hands, others = sum(row.hands for row in rows), sum(row.occluders for row in rows)
    sequences = len({row.sequence for row in rows})
    sizes = sorted({(row.width, row.height) for row in rows})
    size = f"{sizes[0][0]} × {sizes[0][1]} pixels" if len(sizes) == 1 else f"{len(sizes)} sizes"
    return (
        f"{len(rows)} images of {size} in {sequences} sequences, {hands} hands, {others} occluders. "
        f"{len(tiles)} images are shown; the distributions are those of all."
    )


def _tile(tile: Tile) -> str:
    image = tile.labels
    hidden, inside = int((image.visibility == 1).sum()), int((image.visibility > 0).sum())
    says = f"{image.key}, sequence {image.sequence}, frame {image.frame}"
    return (
        f'<figure tabindex="0">{layers(image, tile.picture)}<figcaption>{says}<span>{hidden} of {inside} keypoints '
        f'hidden</span></figcaption><div class="tables" hidden>{facts(image)}</div></figure>'
    )


def _switch(kind: str, name: str, words: str) -> str:
    how = 'type="radio" name="base"' if kind == "base" else 'type="checkbox"'
    checked = " checked" if name in _SHOWN_FIRST else ""
    return f'<label><input {how} id="show-{name}"{checked}> {words}</label>'


def _layer_rules() -> str:
    """Style that hides the layers whose switch is off."""
    return "".join(
        f"body:not(:has(#show-{name}:checked)) .{kind}.{name}{{display:none}}\n" for kind, name, _ in _LAYERS
    )


def _asset(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")
