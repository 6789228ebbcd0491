"""Records of searches: one JSON line per sample, written as it is drawn, and read back (docs/replay.md)."""
