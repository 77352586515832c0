"""Studies of the bench's own promises, over the library and over scenes that were not looked at when they were made."""
