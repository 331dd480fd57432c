"""Generates docs/suites.md from the schemas: what a suite may say, and what it gives."""
