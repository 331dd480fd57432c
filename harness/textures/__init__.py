"""Tileable textures of the named materials: seeded, numpy only.

All fields are float arrays [size, size]; row index grows with ``v``, column index with
``u``, both wrap around, and texel ``(i, j)`` is centred at ``v = (i + 1/2) / size``,
``u = (j + 1/2) / size``, which is how Mitsuba reads a bitmap.
"""
