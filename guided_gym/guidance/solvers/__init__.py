"""Solvers: they give the cost-to-go of the easier problem (r', E'), which a guiding space takes as h."""
