"""Figures that papers published, as data with their source."""
