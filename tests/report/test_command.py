from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hhtbench.campaign.store import Store
from hhtbench.cli.main import main


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
    assert "<h3>andrews</h3>" in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "The one claim holds." in (tmp_path / "summary.md").read_text(encoding="utf-8")


def test_without_a_folder_the_summary_is_printed_and_nothing_written(store, tmp_path):
    result = CliRunner().invoke(main, ["report", "--store", str(store)])
    assert result.exit_code == 0, result.output
    assert result.output.startswith("# Accuracy, work and drift")
    assert "## Wins and losses" in result.output
    assert result.output.count("\n") <= 200
    assert [path.name for path in tmp_path.iterdir() if "sqlite" not in path.name] == []


def test_what_a_report_says_is_there_as_json(store, tmp_path):
    file = tmp_path / "report.json"
    result = CliRunner().invoke(main, ["report", "--store", str(store), "--folder", str(tmp_path), "--json", str(file)])
    assert result.exit_code == 0, result.output
    told = json.loads(file.read_text(encoding="utf-8"))
    assert (told["rows"], told["losses"]) == (75, "")
    assert all(sentence in (tmp_path / "summary.md").read_text(encoding="utf-8") for sentence in told["summary"][:2])
    assert {"drift", "by", "all"} <= set(told["balance"]["headers"])
    tables = told["problems"]["andrews"]["tables"]
    assert "The cheapest solvers at each error" in tables
    assert all(len(row) == len(table["headers"]) for table in tables.values() for row in table["rows"])
    (first, *_) = told["decisions"].values()
    assert len(set(first["headers"])) < len(first["headers"]), "of three factors"


def test_rows_that_cannot_be_read_are_named_on_the_page_and_the_exit_code_is_1(store, tmp_path):
    content = bytearray(store.read_bytes())
    place = content.find(b'"reached": 1.0')
    content[place + 11] ^= 1
    store.write_bytes(content)
    result = CliRunner().invoke(main, ["report", "--store", str(store), "--folder", str(tmp_path)])
    assert result.exit_code == 1
    said = f"{store} is damaged: 1 row cannot be read: "
    assert said in result.stderr
    assert said in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "is damaged: 1 row cannot be read: " in (tmp_path / "summary.md").read_text(encoding="utf-8")


def test_a_truncated_store_without_a_row_that_can_be_read_is_refused_by_name(store, tmp_path):
    store.write_bytes(store.read_bytes()[:20_000])
    result = CliRunner().invoke(main, ["report", "--store", str(store), "--folder", str(tmp_path / "new")])
    assert result.exit_code == 2
    assert f"{store} is damaged: none of its rows can be read" in result.output
    assert not (tmp_path / "new").exists()


def test_report_of_a_missing_store_is_explained(tmp_path):
    result = CliRunner().invoke(main, ["report", "--store", str(tmp_path / "no.sqlite"), "--folder", str(tmp_path)])
    assert result.exit_code == 2
    assert "there is no store" in result.output
