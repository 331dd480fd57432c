"""Numbers from stored arrays: pure functions, nothing that measures is imported."""
