"""Rows of the acceptance matrix, each measured case by case, a module for each section."""
