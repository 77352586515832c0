"""A run from its start to its solution: engine, loop over steps, rows and checkpoints."""
