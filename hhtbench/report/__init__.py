"""Turns evidence into pages: tables and figures in, files out."""

from hhtbench.report.comparison import COMPARISON, STABILITY, write_comparison
from hhtbench.report.content import content_of
from hhtbench.report.markdown import summary_page
from hhtbench.report.write import write_report

__all__ = ["COMPARISON", "STABILITY", "content_of", "summary_page", "write_comparison", "write_report"]
