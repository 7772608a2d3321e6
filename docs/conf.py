"""How the documentation is built: ``make docs``."""

import importlib.metadata

project = "pulsempc"
author = "The pulsempc authors"
copyright = author  # noqa: A001 - Sphinx' name for it
version = release = importlib.metadata.version("pulsempc")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
nitpicky = False
source_suffix = {".md": "myst-nb"}

# ---- pages
myst_enable_extensions = ["amsmath", "attrs_inline", "deflist", "dollarmath"]
myst_heading_anchors = 4
# Notebooks run when the pages are built, each from nothing, and an error in one is an error here.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
suppress_warnings = ["mystnb.unknown_mime_type"]

# ---- reference, from docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
default_role = "any"

# No network is needed to build: other projects are linked where their index can be had.
intersphinx_mapping: dict[str, tuple[str, str | None]] = {}

html_theme = "furo"
html_title = f"pulsempc {release}"
html_static_path = ["_static"]
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": ["view"]}
