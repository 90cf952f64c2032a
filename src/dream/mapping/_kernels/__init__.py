"""Compiled loops of the map. Plain arrays and numbers in, arrays out; lengths in cells unless named."""
