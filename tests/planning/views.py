"""What a pose shows, one element at a time: the slow twin of the kernels of the search."""

from __future__ import annotations

from dream.planning._kernels.lookahead import Views


def shown_by(views: Views, row: int, col: int, heading: int) -> set[int]:
    """The elements that a view from there shows, as `Views` says."""
    node = row * views.cols + col
    base = (row + views.pad) * views.stride + col + views.pad
    here = slice(views.first[heading], views.first[heading + 1])
    clear = views.far[here] <= views.depth[node][views.bearing[here]]
    elements = {base + int(offset) for offset in views.offset[here][clear]}
    if views.listed[node] >= 0:
        pose = views.listed[node] * (len(views.first) - 1) + heading
        listed = views.listed_element[views.listed_first[pose] : views.listed_first[pose + 1]]
        elements.update(map(int, listed))
    return elements
