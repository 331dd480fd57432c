"""Scenes: plain descriptions of geometry, light and camera. Nothing here loads a renderer."""

from harness.scenes.base import Camera, Mesh, Scene, Sphere, XmlScene

__all__ = ["Camera", "Mesh", "Scene", "Sphere", "XmlScene"]
