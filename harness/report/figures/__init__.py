"""Figures, one a file (harness.report.parts finds them). Each takes results and a Canvas."""
