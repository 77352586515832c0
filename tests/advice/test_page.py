"""What docs/advice.md shows runs as printed; the other mechanisms are sound problems."""

from __future__ import annotations

from pathlib import Path

import pytest

import hhtbench as hb
from tests.test_docs import run_page

MECHANISMS = Path(__file__).parent / "mechanisms.py"


@pytest.mark.long  # README trades, too
def test_the_page_trades_and_selects(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    scope = run_page("advice.md")
    assert "Take projected" in capsys.readouterr().out
    assert scope["found"].choices[-1].best.run.error <= 1e-4
    assert scope["advice"].taken is not None
    assert "runs in trade.sqlite" in scope["measured"].evidence
    assert (tmp_path / "trade.html").stat().st_size > 400_000  # plotly is in it: nothing is fetched


@pytest.mark.parametrize("name", ["press", "lorry"])
def test_the_mechanisms_of_the_comparison_keep_their_promises(name):
    assert hb.check(hb.load_problem(f"{MECHANISMS}:{name}")).passed
