"""How the documentation is built: `sphinx-build -W -b html docs docs/_build/html`, or `make docs`.

Nothing is fetched, neither while it is built nor while it is read.
"""

import os
import shutil
import sys
from importlib import metadata
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS.parent)]
os.environ.setdefault("MPLBACKEND", "agg")

project = "handtrack"
author = "the handtrack authors"
copyright = f"{author}, MIT licence"
version = release = metadata.version("handtrack")

extensions = ["myst_nb", "sphinx_gallery.gen_gallery", "math_svg", "module_map"]
exclude_patterns = ["_build", "generated/examples-source", "generated/examples/*.ipynb"]
nitpicky = True

# Pages are MyST Markdown; cells of code in them run while the documentation is built, and an error in one fails it.
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
myst_update_mathjax = False
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_show_tb = True
nb_merge_streams = True

# The gallery wants a header beside the examples; they are copied, so that `examples/` holds examples and nothing else.
EXAMPLES = DOCS / "generated" / "examples-source"
shutil.rmtree(EXAMPLES, ignore_errors=True)
EXAMPLES.mkdir(parents=True)
for example in sorted((DOCS.parent / "examples").glob("[0-9][0-9]_*.py")):
    shutil.copyfile(example, EXAMPLES / example.name)
(EXAMPLES / "GALLERY_HEADER.rst").write_text(
    "Examples\n========\n\nNumbered scripts, in the order of the method. They run while these pages are built; each is "
    "under 80 lines,\nand ``python examples/05_tracking.py --out picture.png`` keeps its picture.\n",
    encoding="utf-8",
)
sphinx_gallery_conf = {
    "examples_dirs": str(EXAMPLES),
    "gallery_dirs": "generated/examples",
    "filename_pattern": r"/\d\d_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 600,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_signature": False,
}

html_theme = "furo"
html_title = "handtrack"
html_static_path = ["_static"]
html_css_files = ["handtrack.css"]
html_math_renderer = "math_svg"
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
