"""``hhtbench reference`` on a plan of its own and on the library's."""

import json
import re

import pytest
from click.testing import CliRunner

from hhtbench.campaign.reference import certify
from hhtbench.campaign.reference.files import write_certificate
from hhtbench.cli.main import main
from hhtbench.protocol.errors import ProblemError


@pytest.fixture
def run():
    return lambda *words: CliRunner().invoke(main, ["reference", *map(str, words)])


@pytest.fixture
def plan(planned, tmp_path):
    """A plan file with three quick entries: certified, certified too, and confirmed by nobody."""
    entries = [
        planned("method=B, form=ode, error=1e-12", name="good", note="a sentence why"),
        planned("method=B, form=ode", name="better"),
        planned("method=A, form=ode", name="alone"),
    ]
    file = tmp_path / "plan.toml"
    tables = [
        f"[{e.name}]\nspec = {e.spec!r}\ntimes = [0.5, 1.0]\ngrid = 0\nfirst = {e.first!r}\n"
        f"second = {list(e.second)}\nnote = {e.note!r}\n"
        for e in entries
    ]
    file.write_text("\n".join(tables), encoding="utf-8")
    (tmp_path / "kept").mkdir()
    for entry in entries:
        write_certificate(certify(entry), tmp_path / "kept")
    return file


def test_build_writes_a_file_for_every_name_and_tells_its_digits(run, plan, tmp_path):
    built = run("build", "good", "--plan", plan, "--out", tmp_path / "new" / "folder")
    assert built.exit_code == 0, built.output
    assert "good: digits: q 12.0, v 14.8" in built.output
    assert "1 of 1 references certified" in built.output
    assert [file.name for file in (tmp_path / "new" / "folder").iterdir()] == ["good.json"]
    new, kept = (json.loads((tmp_path / f / "good.json").read_text()) for f in ("new/folder", "kept"))
    assert (new["values"], new["bars"]) == (kept["values"], kept["bars"])


def test_build_says_what_nobody_confirms_and_exits_with_one(run, plan, tmp_path):
    built = run("build", "alone", "good", "--plan", plan, "--out", tmp_path / "new", "--json", tmp_path / "built.json")
    assert built.exit_code == 1
    told = {one["name"]: one for one in json.loads((tmp_path / "built.json").read_text())}
    assert (told["alone"]["certified"], told["good"]["certified"], round(told["good"]["digits"]["q"])) == (False, True, 12)
    assert "NOT CERTIFIED" in built.output
    assert "1 of 2 references certified" in built.output


def test_check_computes_the_sample_again(run, plan, tmp_path):
    checked = run("check", "--sample", "1", "--plan", plan, "--folder", tmp_path / "kept", "--json", tmp_path / "c.json")
    assert checked.exit_code == 0, checked.output
    assert json.loads((tmp_path / "c.json").read_text())["passed"] is True
    assert "good/q" in checked.output
    assert "better/q" not in checked.output
    assert "3 of 3 claims hold" in checked.output


@pytest.mark.parametrize("quantity", ["q", "v", "observable height"])
def test_check_names_the_quantity_whose_stored_value_was_tampered_with(run, plan, tmp_path, quantity):
    file = tmp_path / "kept" / "good.json"
    stored = json.loads(file.read_text(encoding="utf-8"))
    stored["values"][quantity][1][0] += 1e-8
    file.write_text(json.dumps(stored), encoding="utf-8")
    checked = run("check", "good", "--plan", plan, "--folder", tmp_path / "kept")
    assert checked.exit_code == 1
    failed = [line for line in checked.output.splitlines() if re.search(r"  FAIL  ", line)]
    assert [line.partition("  ")[0] for line in failed] == [f"good/{quantity}"]


def test_check_does_not_pass_a_reference_that_nobody_confirmed(run, plan, tmp_path):
    checked = run("check", "alone", "--plan", plan, "--folder", tmp_path / "kept")
    assert checked.exit_code == 1, checked.output


def test_check_says_that_the_plan_has_other_times_than_the_file(run, plan, tmp_path):
    plan.write_text(plan.read_text(encoding="utf-8").replace("grid = 0", "grid = 4"), encoding="utf-8")
    checked = run("check", "good", "--plan", plan, "--folder", tmp_path / "kept")
    assert checked.exit_code != 0
    assert isinstance(checked.exception, (ProblemError, SystemExit))
    assert "good" in checked.output + str(checked.exception)


def test_missing_folder_is_named(run, plan, tmp_path):
    refused = run("check", "good", "--plan", plan, "--folder", tmp_path / "nowhere")
    assert refused.exit_code != 0
    assert "nowhere" in (refused.output + str(refused.exception))


def test_show_prints_methods_note_and_bars_at_the_stated_times(run, plan, tmp_path):
    shown = run("show", "good", "--folder", tmp_path / "kept", "--json", tmp_path / "good.json")
    assert shown.exit_code == 0, shown.output
    told, kept = (json.loads(file.read_text()) for file in (tmp_path / "good.json", tmp_path / "kept" / "good.json"))
    assert (told["bars"], told["confirmed_by"]) == (kept["bars"], kept["confirmed_by"])
    for text in ("a sentence why", "method=B", "1e-13", "5.0e-13"):
        assert text in shown.output
    assert [line.split()[0] for line in shown.output.splitlines()[-2:]] == ["0.5", "1"]


def test_library_reference_is_shown(run):
    shown = run("show", "knife_edge")
    assert shown.exit_code == 0, shown.output
    assert "closed solution" in shown.output
