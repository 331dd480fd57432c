"""The command line: one verb a file, each with ``register(app)``."""
