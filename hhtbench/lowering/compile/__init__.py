"""How a function of a system's terms becomes a fast call: the choice of a route, sparse derivatives, compiled loops."""
