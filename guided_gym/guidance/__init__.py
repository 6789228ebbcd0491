"""Guiding spaces (paper, Categories of Guidance): they say which node to expand next, and where to.

`base` says what a guiding space is, `cells` holds those that modify nothing, `composed` those that solve an
easier problem, `hybrid` their combinations; `registry` knows all of them by name.
"""
