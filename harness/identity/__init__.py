"""What a stored number stands on, and whether it still stands."""
