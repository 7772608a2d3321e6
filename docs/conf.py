"""How the documentation is built: ``make docs``."""

import importlib.metadata
import re
from typing import Any

project = "pulsempc"
author = "The pulsempc authors"
copyright = author
version = release = importlib.metadata.version("pulsempc")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",  # no page asks the network for anything
]
exclude_patterns = ["_build"]
nitpicky = False
source_suffix = {".md": "myst-nb"}

# ---- pages
myst_enable_extensions = ["amsmath", "attrs_inline", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]  # as GitHub reads it
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
default_role = "py:obj"

# No network is needed to build: other projects are linked where their index can be had.
intersphinx_mapping: dict[str, tuple[str, str | None]] = {}

html_theme = "furo"
html_title = f"pulsempc {release}"
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": ["view"]}


def _formulae(*event: Any) -> None:
    """Take what is indented after a paragraph of a docstring as it stands: formulae and tables."""
    lines: list[str] = event[-1]
    done: list[str] = []
    paragraph = ""
    for line in lines:
        begins = line.startswith("    ") and done and not done[-1]
        if begins and paragraph and not paragraph.startswith(" "):
            done += ["::", ""]
        done.append(line)
        if line:
            paragraph = line
    lines[:] = done


def _short_types(*event: Any) -> tuple[str | None, str | None]:
    """Show types as they are spoken of: ranges are told where each field is described."""

    def short(text: str | None) -> str | None:
        if text is not None:
            text = re.sub(r"~?(numpy\.)?ndarray\[tuple\[[^\]]*\], \S*float64\]\]", "Array", text)
            text = re.sub(r"Annotated\[((?:[^\[\],]|\[[^\[\]]*\])+),[^\[\]]*\]", r"\1", text)
        return text

    signature, returned = event[-2:]
    return short(signature), short(returned)


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", _short_types)
    app.connect("autodoc-process-docstring", _formulae, priority=1)  # before sections are made
