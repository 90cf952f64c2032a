"""Pictures of scenes that share no law with the simulator: other shapes, textures, water, light and camera.

They hold what learns from the simulator's pictures against what it has not seen. Needs embreex, and trimesh
where there are scans.
"""

from unseen.pictures import Picture, pictures

__all__ = ["Picture", "pictures"]
