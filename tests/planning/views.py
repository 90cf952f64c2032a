"""What a pose shows, one element at a time: the slow twin of the kernels of the search."""

from __future__ import annotations

from dream.lattice import Pose
from dream.planning._kernels.views import Views


def shown_by(views: Views, pose: Pose) -> set[int]:
    """The elements that a pose shows, as `Views` says."""
    node, heading = divmod(pose, len(views.first) - 1)
    here = slice(views.first[heading], views.first[heading + 1])
    clear = views.far[here] <= views.depth[node][views.bearing[here]]
    elements = {int(views.tile[node] + offset) for offset in views.offset[here][clear]}
    if views.listed[node] >= 0:
        row = views.listed[node] * (len(views.first) - 1) + heading
        listed = views.listed_element[views.listed_first[row] : views.listed_first[row + 1]]
        elements.update(map(int, listed))
    return elements
