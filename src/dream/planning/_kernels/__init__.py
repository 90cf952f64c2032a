"""Compiled inner loops of the planners; plain arrays in, plain arrays out."""
