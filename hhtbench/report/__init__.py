"""Turns evidence into pages: tables and figures in, files out."""

from hhtbench.report.comparison import COMPARISON, STABILITY, write_comparison
from hhtbench.report.write import write_report

__all__ = ["COMPARISON", "STABILITY", "write_comparison", "write_report"]
