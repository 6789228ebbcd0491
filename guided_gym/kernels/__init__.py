"""Compiled kernels (numba), one small module each: arrays in, arrays out, no objects of ours."""

from __future__ import annotations

from guided_gym.warmup import announce_compilation

announce_compilation()
