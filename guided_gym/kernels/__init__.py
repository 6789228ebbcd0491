"""Compiled kernels (numba), one small module each: arrays in, arrays out, no objects of ours.

Somebody waits for them to compile, so those that every reset needs are written for that, too. No array is
written into a slice or a row (`guided_gym.kernels.plain.copy_row` does it): numba would bring all its
formatting of text, for the error that shapes could raise. And kernels pass each other ``int(ONE)`` and
``bool(YES)`` (`guided_gym.kernels.plain`), not 1 and True: what is called with a literal is compiled once
more. This took a third off the time. Those that make no arrays and return none are compiled without
reference counts (`guided_gym.kernels.plain.borrowing`), which took up to half of the time of the others.
"""

from __future__ import annotations

from guided_gym.compute.compile_lock import share_compilation
from guided_gym.compute.kernel_cache import ensure_kernel_cache
from guided_gym.compute.warmup import announce_compilation

ensure_kernel_cache()
announce_compilation()
share_compilation()
