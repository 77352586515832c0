"""Families of cells that drive one parameter to its extremes, each judged without any solver."""
