"""Compiled kernels (numba), one small module each: arrays in, arrays out, no objects of ours."""
