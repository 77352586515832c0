from __future__ import annotations

import importlib
from collections.abc import Iterator

import pytest

from tests.advice.plugin import FILES, GROUPS
from tests.platform.plugins_fixture import forget, make_distribution


@pytest.fixture(scope="module")
def prices(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An installed distribution with the problem ``fall`` and the solver ``priced``."""
    folder = make_distribution(tmp_path_factory.mktemp("site"), "priced", FILES, GROUPS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        importlib.invalidate_caches()
        yield
        forget("priced")
