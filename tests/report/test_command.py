from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hhtbench.cli import main
from hhtbench.errors import ProblemError
from hhtbench.evidence import read_evidence
from hhtbench.store import Store


@pytest.fixture
def store(rows, tmp_path):
    path = tmp_path / "runs.sqlite"
    with Store(path) as opened:
        for row in rows[:75]:
            opened.put(row, row.key)
    return path


def test_report_of_a_store_is_written_with_the_verification_in_the_folder(store, evidence, tmp_path):
    evidence.write_json(tmp_path / "evidence.json")
    result = CliRunner().invoke(main, ["report", "--store", str(store), "--folder", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "index.html" in result.output
    assert ">andrews</h2>" in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "| 5.1/q" in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_report_of_a_missing_store_is_explained(tmp_path):
    result = CliRunner().invoke(main, ["report", "--store", str(tmp_path / "no.sqlite"), "--folder", str(tmp_path)])
    assert result.exit_code == 2
    assert "there is no store" in result.output


def test_evidence_comes_back_as_it_was_written(evidence, tmp_path):
    evidence.write_json(tmp_path / "e.json")
    found = read_evidence(tmp_path / "e.json")
    assert (found.title, found.rows, found.environment) == (evidence.title, evidence.rows, evidence.environment)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", json.dumps({"schema": "other/1", "title": "", "rows": [], "environment": {}})]
)
def test_file_that_is_no_evidence_is_explained(text, tmp_path):
    (tmp_path / "e.json").write_text(text)
    with pytest.raises(ProblemError, match=r"verify again|Verify again"):
        read_evidence(tmp_path / "e.json")
