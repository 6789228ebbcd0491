"""Solvers: cost-to-go of the easier problem on (r', E'), which a guiding space takes for h."""
