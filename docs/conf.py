"""Sphinx: the pages of this folder, the gallery, the docstrings."""

import os
import re

os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "hhtbench"
author = "the authors of hhtbench"
copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
html_theme = "furo"
html_title = "hhtbench"
exclude_patterns = ["gallery/*", "scenes", "pictures/*.py"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = False
myst_heading_anchors = 3
suppress_warnings = ["config.cache"]

PAGES = {"problems/README.md": "problems.rst", "hht/THEORY.md": "theory.rst", "lowering/LOWERING.md": "lowering.rst"}
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": "/plot_",
    "within_subsection_order": "FileNameSortKey",
    "show_memory": False,
    "capture_repr": (),
    "write_computation_times": False,
    "abort_on_example_error": True,
    "download_all_examples": False,
}


def link_pages(app, name, text):
    """Lead links out of this folder to the page that includes the file; those to files without a page become text."""
    for file, page in PAGES.items():
        text[0] = re.sub(rf"\]\([\w./]*{file}\)", f"](/{page})", text[0])
    text[0] = re.sub(r"\[([^]]+)\]\((?:\.\./[\w./]+|[A-Z]+\.\w+)\)", r"\1", text[0])


def setup(app):
    app.connect("source-read", link_pages)
    app.connect("include-read", lambda app, path, name, text: link_pages(app, name, text))
