"""Compiled searches over the poses of a graph. Plain arrays and numbers in, arrays out."""
