"""Benchmarks of the harness's own parts: seconds per sample, query, map and walk."""
