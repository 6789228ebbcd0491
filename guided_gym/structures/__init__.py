"""Data structures over the kernels: nearest neighbours, segments, shortest-path trees."""
