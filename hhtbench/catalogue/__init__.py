"""Problems, solvers and verifications by name: plugins, specs and files."""
