"""The camera of the simulator."""

from dream.sim.render.rasterizer import FAR, NEAR, Frame, Measurement, Renderer

__all__ = ["FAR", "NEAR", "Frame", "Measurement", "Renderer"]
