"""Writes the report of one verification: ``report.md``, ``convergence.html``, ``evidence.json``."""

from __future__ import annotations

from pathlib import Path

from hhtbench.errors import ProblemError
from hhtbench.evidence import Evidence
from hhtbench.report.markdown import markdown
from hhtbench.report.page import page


def write_report(evidence: Evidence, folder: Path, command: str) -> None:
    """Write the three files into ``folder``, which is made when it is missing.

    Parameters
    ----------
    evidence
        What was measured.
    folder
        Where the files go; files of an earlier report are replaced.
    command
        The command that made the report, printed so that a reader can repeat it.

    Raises
    ------
    ProblemError
        The folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.md").write_text(markdown(evidence, command), encoding="utf-8")
        (folder / "convergence.html").write_text(page(evidence, command), encoding="utf-8")
        evidence.write_json(folder / "evidence.json")
    except OSError as error:
        raise ProblemError(f"the report cannot be written to {folder}: {error.strerror}.") from error
