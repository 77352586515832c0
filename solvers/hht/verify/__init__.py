"""``hhtbench verify paper``: section 5 and the theorems of Jay and Negrut (2007), as numbers."""

from solvers.hht.verify.paper import verify_paper

__all__ = ["verify_paper"]
