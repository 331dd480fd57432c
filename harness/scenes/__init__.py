"""Scenes: plain descriptions of geometry, light and camera. Nothing here loads a renderer."""

from harness.scenes.base import AreaLamp, Camera, Mesh, PointLamp, Scene, Sphere, XmlScene

__all__ = ["AreaLamp", "Camera", "Mesh", "PointLamp", "Scene", "Sphere", "XmlScene"]
