"""Turns evidence into pages: tables and figures in, files out."""

from hhtbench.report.comparison import write_comparison
from hhtbench.report.write import write_report

__all__ = ["write_comparison", "write_report"]
