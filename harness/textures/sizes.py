"""Size of the textures of the named materials."""

SIZE = 256
"""Texels along each side."""
