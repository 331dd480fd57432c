"""Carries out a plan: what is missing is fitted and measured, and stored as it finishes."""
