"""One attempt at a step: the loops' memory, Newton's iteration, acceptance."""
