"""Sphinx configuration of the documentation site; `make docs` builds it."""

import re
from pathlib import Path

import pointray

project = "pointray"
copyright = "the pointray developers, Apache-2.0"
version = release = pointray.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_llms_txt",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["site"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_enable_extensions = ["colon_fence", "dollarmath", "deflist", "attrs_inline"]
myst_heading_anchors = 4
nitpicky = True
nitpick_ignore_regex = [("py:obj", ".*")]  # words in backticks in docstrings, of which parameters have no page

autosummary_generate = False
default_role = "autolink"
autodoc_typehints = "none"  # the docstrings have shapes and units too
autodoc_default_options = {"members": True}
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_theme = "pydata_sphinx_theme"
html_title = "pointray"
html_baseurl = "https://pointray.readthedocs.io/en/stable/"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_theme_options = {
    "github_url": "https://github.com/pointray/pointray",
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "use_edit_page_button": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_show_sourcelink = False
llms_txt_summary = "pointray ray traces point clouds as smooth, lit surfaces, on any CPU"
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

ROOT = Path(__file__).parents[1]
SOURCE = "https://github.com/pointray/pointray"


def read_source(app, name, source):
    """Take pages of `project/` from files at the top of the project; link files outside `docs/` to the repository."""
    page = ROOT / f"{Path(name).name.upper()}.md"
    if name.startswith("project/") and page.exists():
        text = re.sub(r"\]\(docs/", "](../", page.read_text())
        source[0] = re.sub(r"\]\(([A-Z]+)\.md", lambda link: f"]({link[1].lower()}.md", text)
    up = "../" * name.count("/")
    top = r"\]\((?:\.\./)+(ARCHITECTURE|CONTRIBUTING|CHANGELOG)\.md"
    source[0] = re.sub(top, lambda link: f"]({up}project/{link[1].lower()}.md", source[0])
    outside = r"\]\((?:\.\./)*((?:examples|bench|src|tests|native)/?[^)#]*|LICENSE|README\.md)\)"
    source[0] = re.sub(outside, lambda link: f"]({SOURCE}/blob/main/{link[1]})", source[0])


def setup(app):
    """Register the event handler, and read pages in parallel: one extension does not say whether it allows that."""
    app.connect("source-read", read_source)
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
