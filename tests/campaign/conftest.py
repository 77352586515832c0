from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.campaign.plugin import FILES, GROUPS
from tests.platform.plugins_fixture import forget, make_distribution


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installed distribution from outside; its folder."""
    folder = make_distribution(tmp_path / "site", "outside", FILES, GROUPS)
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
    yield folder
    forget("outside")
