"""Explicit Runge-Kutta methods on the underlying ODE in a compiled loop, projected onto both levels after every step."""
