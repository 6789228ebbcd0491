"""What knows the truth: the oracle and the metric. No guiding space but the exact one may import it."""
