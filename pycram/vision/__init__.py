"""Cameras and the rasterizer: what is seen from where, pixel by pixel, without the engine."""
