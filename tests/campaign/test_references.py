"""``--reference auto``: a problem of one's own is certified before its solvers are compared."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from hhtbench.campaign import Campaign, Grid, references
from hhtbench.campaign.reference import auto
from hhtbench.campaign.references import auto_references
from hhtbench.campaign.sources import SourceReader
from hhtbench.campaign.store import load_rows
from hhtbench.catalogue.specs import parse_spec
from hhtbench.cli.main import main

MINE = """\
import jax.numpy as jnp
import hhtbench as hb

class Swing(hb.System):
    def force(self, t, q, v):
        return jnp.stack([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2])

swing = hb.Problem(name="swing", system=Swing(), t_span=(0, 0.5), q0=[1, 0], v0=[0, 0])
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def campaign() -> Campaign:
    return Campaign(grids=(Grid(problems=("mine.py:swing", "knife_edge"), solvers=("hht",)),), reference="auto")


def test_a_problem_of_ones_own_is_certified_and_its_solvers_are_judged(mine: Path):
    options = ["--problems", "mine.py:swing", "--solvers", "scipy(method=DOP853)", "--reference", "auto", "--jobs", "1"]
    result = CliRunner().invoke(main, ["run", *options, "--no-timing", "--store", "runs.db"])
    assert result.exit_code == 0, result.output
    assert "reference of mine.py:swing: certified" in result.output
    (file,) = (mine / "runs.db.references").iterdir()
    families = {other["solver"] for other in json.loads(file.read_text())["confirmed_by"] if other["independent"]}
    assert families == {"projected(method=DOP853)"}
    rows = [row for row in load_rows(mine / "runs.db") if row.success]
    errors = [row.metrics["errors"]["q"]["max_scaled"] for row in rows]
    assert {row.metrics["errors"]["against"] for row in rows} == {"reference"}
    assert min(errors) < 1e-6 < 1e-4 < max(errors)


def test_nothing_is_certified_twice_and_a_changed_problem_again(mine: Path, monkeypatch: pytest.MonkeyPatch):
    def noted(spec: str, file: Path, seconds: float) -> str:
        asked.append(spec)
        file.write_text(spec)
        return ""

    class Here:
        """A pool that runs at once."""

        def __init__(self, jobs: int) -> None: ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def submit(self, function, *arguments):
            future = auto.Future()
            future.set_result(noted(*arguments))
            return future

    asked: list[str] = []
    monkeypatch.setattr(auto, "worker_processes", Here)
    find = lambda: auto_references(campaign(), mine / "runs.db", 1, lambda _: None)  # noqa: E731
    first = find()
    assert asked == ["mine.py:swing", "knife_edge"]
    assert find() == first
    (mine / "mine.py").write_text(MINE.replace("-9.81", "-3.7"))
    assert find() != first
    assert asked == ["mine.py:swing", "knife_edge", "mine.py:swing"]


def test_problems_with_a_truth_of_their_own_are_left_alone(mine: Path):
    assert auto.certify_one("knife_edge", mine / "knife.json") == auto.KNOWN
    assert not (mine / "knife.json").exists()


def test_families_that_disagree_certify_nothing_and_it_is_said(mine: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys.modules["hhtbench.campaign.reference.certify"], "WORST_BAR", 1e-30)
    monkeypatch.setattr(auto, "methods_for", lambda problem: [(auto.GGL, (auto.EXPLICIT,))])
    said = auto.certify_one("mine.py:swing", mine / "swing.json")
    assert said.startswith("not certified: collocation(form=ggl) and projected(method=DOP853) do not agree")
    assert said.endswith("A shorter span may have a reference: of chaotic motion nobody knows a long one")
    assert not (mine / "swing.json").exists()


@pytest.mark.parametrize(
    ("force", "told"),
    [("raise RuntimeError('no force today')", "RuntimeError: no force today"), ("return jnp.nan * q", "nonfinite_callback")],
)
def test_the_reason_is_what_the_functions_say_and_chaos_is_not_blamed(force, told, mine: Path):
    (mine / "bad.py").write_text(MINE.replace("return jnp.stack([0.0, -9.81])", force))
    said = auto.certify_one("bad.py:swing", mine / "bad.json")
    assert told in said
    assert "JAX" not in said
    assert "chaotic" not in said


def test_a_certificate_does_not_rest_on_what_measures_runs():
    reader, seen = SourceReader(), []
    for solver in references.RESTS_ON:
        behind = reader.behind(parse_spec("knife_edge"), parse_spec(solver))
        seen += [name for name in behind if not name.startswith(references.NOT_THESE)]
    assert "hhtbench.lowering.dynamics.kkt" in seen
    assert not [
        name for name in seen if "drift" in name or name in ("hhtbench.checks.result.judge", "hhtbench.checks.result.motion")
    ]
