"""The search tree, the local planner, and the loop; nothing here knows a guiding space or the oracle."""
