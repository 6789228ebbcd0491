"""Processes and compiled code: worker pools, the cache of kernels, warming up."""
