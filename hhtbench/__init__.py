"""hhtbench: integrate constrained mechanical systems and choose with evidence how.

Importing the package switches JAX to 64-bit numbers.
"""

import jax

jax.config.update("jax_enable_x64", True)
