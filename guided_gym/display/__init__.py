"""Scenes, pages and pictures of problems and searches; ``web/`` draws in the browser."""
