"""Compiled steps of the filters: plain float64 arrays and numbers in, new ones out."""
