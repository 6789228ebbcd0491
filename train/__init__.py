"""Programs: evaluate, train, reproduce the paper; the command line."""
