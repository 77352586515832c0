"""Problems: one file each, registered under the entry-point group ``hhtbench.problems``."""
