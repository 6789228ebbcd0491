"""Robots, environments and the configuration spaces that they make."""
