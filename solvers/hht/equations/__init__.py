"""The equations of one step as pure array functions, and their numbers."""
