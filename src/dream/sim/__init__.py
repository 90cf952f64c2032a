"""A world to look at and move in."""
