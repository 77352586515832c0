from __future__ import annotations

import importlib
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.platform.plugins_fixture import PROBLEM, SOLVER, forget, make_distribution

PASSING = """\
    from hhtbench.protocol.evidence import Evidence, Row

    def verify(progress=None, jobs=1):
        if progress is not None:
            progress("claims", 1, 2)
        rows = (Row(id="1/q", claim="it stands", measured=0.0, bound="0", passed={passed}),)
        return Evidence(title="stands", rows=rows)
"""


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installed third-party distribution with two problems, a solver and two verifications."""
    groups = {
        "hhtbench.problems": {
            "acme_fall": "acme_plugin.fall:problem",
            "acme_slide": "acme_plugin.slide:problem",
            "acme_nonsense": "acme_plugin.fall:makes_nonsense",
            "acme_missing": "acme_plugin.fall:absent",
            "acme_broken": "acme_plugin.broken:problem",
        },
        "hhtbench.solvers": {"acme_still": "acme_plugin.still:Still"},
        "hhtbench.verifications": {"acme_good": "acme_plugin.good:verify", "acme_bad": "acme_plugin.bad:verify"},
    }
    files = {
        "acme_plugin/__init__.py": "",
        "acme_plugin/fall.py": PROBLEM,
        "acme_plugin/slide.py": PROBLEM,
        "acme_plugin/broken.py": "import a_library_that_is_missing\n",
        "acme_plugin/still.py": SOLVER,
        "acme_plugin/good.py": PASSING.format(passed=True),
        "acme_plugin/bad.py": PASSING.format(passed=False),
    }
    folder = make_distribution(tmp_path / "site", "acme", files, groups)
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
    yield folder
    forget("acme_plugin")


@pytest.fixture
def mechanism(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's own file in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_mechanism.py").write_text(textwrap.dedent(PROBLEM), encoding="utf-8")
    return tmp_path
