"""Sphinx: the pages of this folder, the gallery, the docstrings."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "hhtbench"
author = "the authors of hhtbench"
copyright = author
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
html_theme = "furo"
html_title = "hhtbench"
exclude_patterns = ["gallery"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = False
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing", "config.cache"]  # links to files that are no pages
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
