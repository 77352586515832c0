"""The physics and its protocol: systems, problems, their checks of arguments and errors."""
