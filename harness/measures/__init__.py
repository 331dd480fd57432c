"""Measures: one file each. Jobs in, outcomes out; see :mod:`harness.measures.base`."""
