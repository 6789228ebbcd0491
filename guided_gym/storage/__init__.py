"""Paths on disk, safe against kills and damage."""
