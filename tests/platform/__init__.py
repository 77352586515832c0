"""Claims about the platform around the numerics."""
