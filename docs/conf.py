"""Configure Sphinx. ``make docs`` builds the site without a network and with warnings as errors."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx_gallery.sorting import FileNameSortKey

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "docs" / "_ext")]
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import evanesce  # noqa: E402

project = "evanesce"
author = "evanesce developers"
project_copyright = author
release = version = evanesce.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "docstrings",
]
exclude_patterns = ["_build"]
templates_path = ["_templates"]
# Every name that a page or a docstring refers to is found; there is no inventory of other projects without a network.
nitpicky = True
nitpick_ignore_regex = [
    (
        r"py:.*",
        r"(abc|numpy|np|scipy|pathlib|collections|typing|enum|pydantic|matplotlib|mitsuba|torch|rerun|gymnasium)\b.*",
    ),
]

# Pages: Markdown that GitHub shows as well.
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["config.cache"]

# Python API: a page for every public name, a page for every module of the packages below the studies.
autosummary_generate = True
autodoc_mock_imports = [
    name
    for name in ("felupe", "pypardiso", "torch", "rerun", "mcap", "mcap_ros2", "gymnasium")
    if find_spec(name) is None
]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

bibtex_bibfiles = ["references.bib"]

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r".*\.py",
    "within_subsection_order": FileNameSortKey,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 0,
    "thumbnail_size": (560, 360),
    "reference_url": {},
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = "evanesce"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_math_renderer = "mathml"
html_sidebars = {"index": []}
html_theme_options = {
    "logo": {"text": "evanesce"},
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "navigation_with_keys": False,
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}


def _inline_math(translator: Any, node: nodes.math) -> None:
    """Write an inline equation as MathML, which browsers show without a script."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block_math(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed equation as MathML."""
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register the renderer of equations."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
