"""From a start to a solution: the engine, the loop over steps, rows and checkpoints."""
