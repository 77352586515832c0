"""Linear algebra of Newton's matrix: its entries, the choice of a factorisation, and solves."""
