"""The kinds of material that a mapping can ask for, by its ``type``: one a file."""
