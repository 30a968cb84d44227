"""Rays through a scene. Imports `host` and `reflection`."""
