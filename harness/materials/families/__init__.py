"""Parametric families: reflectance models whose parameters are part of the condition."""
