"""The numbered equations of one step as pure array functions."""
