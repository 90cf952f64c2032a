"""Planners that move in three dimensions."""
