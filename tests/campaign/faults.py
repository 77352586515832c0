"""Kills runners and workers of campaigns at random moments: ``python -m tests.campaign.faults [--kills 50] [--seed 1]``.

Every campaign is started again with the same command until it is done, and compared with one that nobody disturbed.  Printed
are the rows that were lost (seen in the store once, later not or otherwise), doubled, missing or different at the end, times
aside; the exit code is 1 where there is one.  No test: it takes some minutes.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hhtbench.errors import ProblemError
from hhtbench.store import RunRow, load_rows
from tests.campaign.plugin import FILES, GROUPS
from tests.platform.plugins_fixture import make_distribution

RUNNER_SHARE = 0.3  # of the kills; the others hit a worker
PAUSES = (0.2, 6.0)  # s between two kills
RTOL = [f"{mantissa}e-{power}" for power in (3, 4) for mantissa in range(1, 9)] + ["1e-6"]


@dataclass
class Campaign:
    """One campaign, its store and what happened to it."""

    folder: Path
    store: Path
    solvers: str
    kills: Counter[str] = field(default_factory=Counter)
    seen: dict[str, RunRow] = field(default_factory=dict)
    lost: int = 0

    def start(self) -> subprocess.Popen[str]:
        """The runner."""
        command = [sys.executable, "-c", "from hhtbench.cli import main; main()", "run", "--store", str(self.store)]
        command += ["--problems", "fall, simple_pendulum", "--solvers", self.solvers, "--rtol", ",".join(RTOL)]
        command += ["--jobs", "2", "--max-seconds", "20"]
        environment = {**os.environ, "PYTHONPATH": str(self.folder)}
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    def look(self) -> None:
        """At the rows that are there: none that was there is gone or another."""
        try:
            now = {row.key: row for row in load_rows(self.store)}
        except ProblemError:  # the file is not there yet
            now = {}
        self.lost += sum(key not in now or result(now[key]) != result(row) for key, row in self.seen.items())
        self.seen = now


def result(row: RunRow) -> dict[str, Any]:
    """A row without what differs from run to run."""
    values = dict(vars(row))
    for name in ("timing", "environment", "created"):
        del values[name]
    return values


def workers_of(runner: int) -> list[int]:
    """Worker processes of a runner, from the system's table."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == runner and "hhtbench.campaign.worker" in (entry / "cmdline").read_text():
                found.append(int(entry.name))
    return found


def disturb(campaign: Campaign, most: int, chance: random.Random) -> None:
    """Run the campaign to its end with up to ``most`` kills."""
    runner = campaign.start()
    due, at_runner = time.monotonic() + chance.uniform(*PAUSES), False
    while (code := runner.poll()) is None or code == -signal.SIGKILL:
        if code is not None:
            campaign.look()
            runner = campaign.start()
        if time.monotonic() > due and campaign.kills.total() < most:
            victims = [runner.pid] if at_runner else workers_of(runner.pid)  # none yet: it waits for one
            if victims:
                with suppress(ProcessLookupError):
                    os.kill(chance.choice(victims), signal.SIGKILL)
                    campaign.kills["runner" if at_runner else "worker"] += 1
                due, at_runner = time.monotonic() + chance.uniform(*PAUSES), chance.random() < RUNNER_SHARE
        time.sleep(0.01)
    campaign.look()
    if code:
        raise SystemExit(f"the runner ended with {code}")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    chance = random.Random(chosen.seed)
    kills: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = make_distribution(Path(name) / "site", "outside", FILES, GROUPS)
        solvers = "told(seconds=0.1), told(does=segv), told(does='raise'), hht, ida(form=ggl)"
        calm = Campaign(folder, Path(name) / "calm.sqlite", solvers)
        disturb(calm, 0, chance)
        expected = {row.key: result(row) for row in load_rows(calm.store)}
        while kills.total() < chosen.kills:
            campaign = Campaign(folder, Path(name) / f"{kills.total()}.sqlite", solvers)
            disturb(campaign, chosen.kills - kills.total(), chance)
            rows = load_rows(campaign.store)
            found = {row.key: result(row) for row in rows}
            faults["lost"] += campaign.lost
            faults["doubled"] += len(rows) - len(found)
            faults["missing"] += len(expected.keys() - found.keys())
            faults["different"] += sum(found.get(key, row) != row for key, row in expected.items())
            faults["too many"] += len(found.keys() - expected.keys())
            kills += campaign.kills
            told = ", ".join(f"{count} {what}s" for what, count in campaign.kills.items())
            print(f"{len(rows)} rows after {told} killed", flush=True)  # noqa: T201
    told = ", ".join(f"{count} {what}" for what, count in faults.items())
    print(f"{kills.total()} kills ({kills['runner']} of runners, {kills['worker']} of workers): rows {told}")  # noqa: T201
    sys.exit(1 if faults.total() else 0)


if __name__ == "__main__":
    main()
