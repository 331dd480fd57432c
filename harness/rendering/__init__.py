"""Rendering with Mitsuba. Submodules other than ``llvm`` and ``variant`` need a variant set."""
