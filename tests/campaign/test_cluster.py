"""A campaign on a cluster of Dask: real worker processes, one of them killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from hhtbench.campaign.store import load_rows
from hhtbench.cli.main import main

distributed = pytest.importorskip("distributed", reason="needs the extra hhtbench[dask]")


@pytest.fixture
def cluster(outside: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPATH", str(outside))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        yield cluster


def run(store: Path, *options: str) -> str:
    result = CliRunner().invoke(main, ["run", "--problems", "fall", "--store", str(store), *options])
    assert result.exit_code == 0, result.output
    return result.output


def test_rows_of_a_cluster_are_those_of_the_local_pool_with_a_worker_killed(cluster, tmp_path: Path):
    log = tmp_path / "log"
    told = f"told(seconds=0.15, log='{log}')"
    asked = ["--solvers", f"{told}, told(does=segv), told(does=decline)", "--no-timing", "--rtol"]
    asked += [", ".join(f"{value}e-3" for value in range(1, 9)) + ", 1e-6"]
    killed = []

    def kill_one() -> None:
        while not log.exists() or len(log.read_text().split()) < 8:
            time.sleep(0.02)
        worker = next(iter(cluster.workers.values()))
        os.kill(worker.pid, signal.SIGKILL)
        killed.append(worker.pid)

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    said = run(tmp_path / "far.db", *asked, "--executor", "dask", "--scheduler", cluster.scheduler_address)
    killer.join(timeout=1)
    assert killed
    assert "27 run now" in said
    near = run(tmp_path / "near.db", *asked, "--jobs", "2")
    assert "27 run now" in near
    assert results(tmp_path / "far.db") == results(tmp_path / "near.db")
    assert len(results(tmp_path / "far.db")) == 27
    assert "0 run now" in run(tmp_path / "far.db", *asked)


def results(store: Path) -> dict[str, tuple[str, object, object]]:
    return {row.key: (row.status, row.metrics, row.counters) for row in load_rows(store)}


@pytest.mark.long
def test_times_are_taken_here_and_carry_the_machine(cluster, tmp_path: Path):
    options = ["--executor", "dask", "--scheduler", cluster.scheduler_address]
    assert "1 timed now" in run(tmp_path / "runs.db", "--solvers", "told", "--rtol", "1e-3", *options)
    (row,) = load_rows(tmp_path / "runs.db")
    assert row.timing["repeats"] >= 1
    assert row.timing["machine"]["processor"] == row.environment["processor"]


def test_an_address_where_nobody_answers_is_told(outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hhtbench.campaign.cluster.CONNECT", 0.5)
    options = ["--problems", "fall", "--solvers", "told", "--rtol", "1e-3", "--store", str(tmp_path / "runs.db")]
    result = CliRunner().invoke(main, ["run", *options, "--executor", "dask", "--scheduler", "tcp://127.0.0.1:9"])
    assert result.exit_code == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in result.output
    result = CliRunner().invoke(main, ["run", *options, "--executor", "dask"])
    assert "--scheduler ADDRESS belong together" in result.output
