"""Suites: what a YAML file may say, and the trials that it stands for."""
