"""Learned guidance: networks on numpy, their files, and the guiding spaces that they make."""
