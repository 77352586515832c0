"""``hhtbench study stability``: parameter ranges in which solvers are safe, fail, or mislead."""
