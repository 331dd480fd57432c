"""Meshes made in code; plain arrays, no renderer is loaded."""
