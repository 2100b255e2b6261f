"""Settings of Sphinx for docs/build."""

import importlib.metadata

project = "sunarc"
author = "The sunarc developers"
version = release = importlib.metadata.version("sunarc")
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
html_theme = "furo"
html_title = f"sunarc {release}"
html_show_sphinx = False
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
myst_heading_anchors = 4
autodoc_typehints = "none"
numpydoc_show_class_members = False
pygments_style = "friendly"
