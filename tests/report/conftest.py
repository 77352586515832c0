from __future__ import annotations

import pytest

from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.report import write_comparison
from tests.report.drawings import opened
from tests.report.synthetic import rows as campaign

COMMAND = "hhtbench report --store runs.sqlite --folder reports/latest"


@pytest.fixture(scope="session")
def rows():
    return campaign()


@pytest.fixture(scope="session")
def evidence():
    claims = (Row(id="5.1/q", claim="order of q", measured=2.0, bound="2.00 +- 0.05", passed=True),)
    return Evidence(title="The paper's claims", rows=claims, seconds=1.0)


@pytest.fixture(scope="session")
def report(rows, evidence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    write_comparison(rows, folder, COMMAND, evidence)
    return folder


@pytest.fixture(scope="session")
def page(report):
    return (report / "index.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def whole(page):
    """The page with all of its parts opened."""
    return opened(page)
