"""The process: workers, progress, interruption, the terminal, settings of JAX."""
