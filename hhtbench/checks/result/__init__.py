"""Checks whether a success that a solver reports is believable, whoever wrote it."""
