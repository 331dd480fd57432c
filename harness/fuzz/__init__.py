"""Hostile input by the thousand: suites, stored results, material files."""
