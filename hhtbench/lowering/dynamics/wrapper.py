"""What the dynamics around another dynamics have in common."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from hhtbench.lowering.dynamics.dynamics import Dynamics, EquationsOfMotion


class Wrapper(eqx.Module, EquationsOfMotion):
    """Some functions of a dynamics, ``inner``, changed; the rest is passed through."""

    inner: Dynamics

    def __getattr__(self, name: str) -> Any:
        if name == "inner" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.inner, name)
