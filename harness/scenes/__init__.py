"""Scenes: plain descriptions of geometry, light and camera. Nothing here loads a renderer."""
