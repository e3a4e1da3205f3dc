"""A `{module-map}` directive: package folders in, a table of their modules and what each takes and gives out.

The text is the first sentence of each module's docstring, read from the source, so the map cannot fall behind the code.
"""

import ast
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parent.parent.parent


def summary(file: Path) -> str:
    """First sentence of a module's docstring on one line."""
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    first = " ".join(text.split("\n\n")[0].split())
    end = first.find(". ")
    return first if end < 0 else first[: end + 1]


def inline(text: str) -> list[nodes.Node]:
    """Text with the words between backticks as code."""
    parts = text.replace("``", "`").split("`")
    return [nodes.literal("", part) if i % 2 else nodes.Text(part) for i, part in enumerate(parts) if part]


class ModuleMap(Directive):
    """`{module-map} folder`: the modules of one folder, without those of its subfolders."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        folder = ROOT / self.arguments[0]
        files = [file for file in sorted(folder.glob("*.py")) if file.stem not in ("__init__", "__main__")]
        if not files:
            raise self.error(f"module-map: no modules in '{self.arguments[0]}'")
        body = nodes.tbody()
        for file in files:
            name = nodes.paragraph("", "", nodes.literal("", file.stem))
            words = nodes.paragraph("", "", *inline(summary(file)))
            body += nodes.row("", nodes.entry("", name), nodes.entry("", words))
        group = nodes.tgroup("", cols=2)
        group += [nodes.colspec(colwidth=24), nodes.colspec(colwidth=76), body]
        return [nodes.table("", group)]


def setup(app: Sphinx) -> dict[str, object]:
    """Register the directive."""
    app.add_directive("module-map", ModuleMap)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
