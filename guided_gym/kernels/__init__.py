"""Compiled kernels (numba), one small module each: arrays in, arrays out, no objects of ours."""

from __future__ import annotations

from guided_gym.compute.compile_lock import share_compilation
from guided_gym.compute.kernel_cache import ensure_kernel_cache
from guided_gym.compute.warmup import announce_compilation

ensure_kernel_cache()
announce_compilation()
share_compilation()
