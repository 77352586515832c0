"""One attempt at a step: Newton's iteration, stopping tests, acceptance."""
