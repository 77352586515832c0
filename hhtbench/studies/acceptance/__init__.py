"""The acceptance matrix at the extremes: every row measured on HHT and, as far as they can be asked, on other solvers."""
