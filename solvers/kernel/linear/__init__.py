"""The linear algebra of Newton's matrix: what its entries are, which factorisation serves them, and solves with it."""
