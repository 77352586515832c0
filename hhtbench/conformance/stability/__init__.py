"""``hhtbench study stability``: where solvers are safe, where they fail, and how they end."""
