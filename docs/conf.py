"""The documentation site: `python -m sphinx -W -b html docs docs/_site`."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "_ext")]

import rlgcomp  # noqa: E402

project = "rlgcomp"
author = "The authors of rlgcomp"
copyright = "the authors of rlgcomp, Apache-2.0"  # noqa: A001
release = rlgcomp.__version__
extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_copybutton",
    "executed", "generated", "mathml",
]  # fmt: skip
exclude_patterns = ["_site", "_run", "_ext", "_made", "notebook"]
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "none"
default_role = "code"
autodoc_default_options = {
    "exclude-members": "set_fit_request, set_predict_request, set_score_request, set_transform_request, get_metadata_routing",
}
suppress_warnings = ["myst.strikethrough"]
html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"rlgcomp {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["access.js"]
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"
copybutton_selector = "div:not(.output) > div.highlight > pre"
