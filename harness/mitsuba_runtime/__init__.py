"""Mitsuba's global state: its variant, the LLVM library behind it, its search path, and plugins of
a user's own. Set here and nowhere else."""
