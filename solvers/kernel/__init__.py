"""The kernel of the compiled solvers: their memory, linear algebra, accelerations, and projection onto constraints."""
