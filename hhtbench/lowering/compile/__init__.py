"""Compilation of a system's functions: choice of a route, sparse derivatives, compiled loops."""
