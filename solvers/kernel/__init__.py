"""What compiled solvers share: the memory of their loops, linear algebra, accelerations, and projection onto constraints."""
