"""Formulas in, inline SVG out: pages need no script and no network to show them.

Matplotlib's mathtext sets the formula; its glyphs become one path in the colour of the text around it, so that light
and dark themes both work. The TeX source stays in the page as its description.
"""

from functools import lru_cache
from html import escape

from docutils import nodes
from matplotlib import rc_context
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath, TextToPath
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

_SIZE = 100.0  # units of the drawing for one em
_EM = 1.08  # em of the page for one em of the formula: its letters are lower than those of the text
_COMMANDS = {1: "M", 2: "L", 3: "Q", 4: "C"}


@lru_cache(maxsize=1024)
def svg_from_tex(tex: str) -> str:
    """The formula as an `<svg>` element that sits on the text's base line."""
    formula = f"${' '.join(tex.split())}$"
    with rc_context({"mathtext.fontset": "stix"}):
        font = FontProperties(size=_SIZE, math_fontfamily="stix")
        path = TextPath((0, 0), formula, prop=font)
        _, _, descent = TextToPath().get_text_width_height_descent(formula, font, ismath=True)
    box = path.get_extents()
    low, high = min(box.y0, -descent) - 4.0, box.y1 + 4.0
    left, width = box.x0 - 4.0, box.width + 8.0
    outline = " ".join(
        "Z" if code == 79 else _COMMANDS[int(code)] + " ".join(f"{x:.1f} {-y:.1f}" for x, y in points.reshape(-1, 2))
        for points, code in path.iter_segments(curves=True, simplify=False)
    )
    em = _EM / _SIZE
    return (
        f'<svg class="formula" role="img" aria-label="{escape(tex, quote=True)}" '
        f'viewBox="{left:.1f} {-high:.1f} {width:.1f} {high - low:.1f}" '
        f'style="width:{width * em:.3f}em;height:{(high - low) * em:.3f}em;vertical-align:{low * em:.3f}em">'
        f'<path d="{outline}"/></svg>'
    )


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(svg_from_tex(node.astext()))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula-block">{svg_from_tex(node.astext())}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, object]:
    """Register the renderer under the name that conf.py chooses."""
    app.add_html_math_renderer("math_svg", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
