"""``hhtbench study stability`` and ``hhtbench study atlas``: where solvers are safe, where they fail, and how they end."""
