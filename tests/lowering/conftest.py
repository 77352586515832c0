"""What the tests of the lowering share."""

import pytest


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """A cache folder of this test's own."""
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
