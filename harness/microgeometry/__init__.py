"""Microgeometry: displaced, textured surfaces: descriptions, tracing, queries."""
