"""Hostile cases of any solver: one parameter after the other up to its extremes, each judged by what is known without it."""
