"""``hhtbench verify``: numerical checks of the theory, such as section 5 and the theorems of Jay and Negrut (2007)."""

from solvers.hht.verify.paper import verify_paper

__all__ = ["verify_paper"]
