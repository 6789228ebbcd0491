"""The truth: the oracle and the metric. Only the exact guiding space may import it."""
