"""Planners of other libraries, as guidances: each is watched, see `guided_gym.search.watch`."""
