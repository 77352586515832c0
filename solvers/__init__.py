"""Solvers: each turns a Problem and a Request into a Solution."""
