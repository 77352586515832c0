"""Rows of the acceptance matrix, each measured case by case; one module per section."""
