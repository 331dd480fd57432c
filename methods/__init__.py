"""The adapters: one importance-sampling method a file, named after the method."""
