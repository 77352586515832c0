"""The native engine: the host engine's steps in compiled loops, for systems whose functions become machine code."""
