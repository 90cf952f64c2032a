"""What kernels of the map and their callers agree on: bits of a cell, kinds of pixels, lengths in cells."""

EXPLORED = 1
"""The paper's E_t."""
BARE = 2
"""A return from below the height band fell in."""
SEABED = 4
"""A return from the seabed or a target fell in."""
CROSSED = 8
"""A ray at the vehicle's own height passed through, or the launch was there."""
RETURNED = 16
"""A return from any height fell in."""
GROUNDED = 32
"""What is solid here was seen down to the lower edge of the height band."""

KNOWN = EXPLORED | BARE | CROSSED | RETURNED
"""Any of these, or solid, makes a cell known."""

GROUND, THING, UNSURE = 0, 1, 2
"""What a pixel is by its label: seabed, anything else, or seabed if its height agrees."""

WEIGHT = 16
"""What a pixel that surely shows target adds to its cell's target count, and one that is not believed at all
to its doubt."""
DOUBT_BITS = 32
"""A cell's doubt is in the bits above so many, its target count in those below."""

EDGE = 1e-9
"""Cells: a position on the edge of two is in the upper one, whatever its rounding."""

BLOCK_BITS = 6
BLOCK = 1 << BLOCK_BITS
"""Cells along a block."""
RAYS = 1024
"""Rays in a full turn: a power of two. At 8 m they are 5 cm apart, so that several cross every cell."""
RAY_MASK = RAYS - 1
"""Wrapping is one `and`."""
