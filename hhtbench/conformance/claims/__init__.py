"""What every solver is held to, a module for each kind of claim; every claim is a function and its docstring."""
