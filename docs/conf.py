"""How the pages become a site (`make docs`). Sphinx reads this file."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "skyfix"
author = "the authors of skyfix"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generate.mathml"]
exclude_patterns = ["generate"]

# Links to pages, to headings and to files of the repository are checked: one that leads nowhere is a warning, and
# `make docs` fails on warnings.
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
highlight_language = "none"

autodoc_default_options = {
    "members": True,
    "imported-members": True,
    "member-order": "groupwise",
    "exclude-members": "model_config, model_post_init",  # pydantic's own
}
default_role = "py:obj"
# The name of a field in a section "Attributes" is looked up as a reference; many classes have a `lat_deg`.
suppress_warnings = ["ref.python"]
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = True
napoleon_numpy_docstring = True
napoleon_use_ivar = True  # a section "Attributes" and a field's own docstring do not describe it twice

# Nothing is loaded from elsewhere when a page is read: the theme brings what it needs, formulas are MathML.
html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["skyfix.css"]
html_title = "skyfix"
html_math_renderer = "mathml"
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_theme_options: dict[str, object] = {"footer_icons": []}
