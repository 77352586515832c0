"""Claims that every solver must meet, one module per kind; each is a function whose docstring states the claim."""
