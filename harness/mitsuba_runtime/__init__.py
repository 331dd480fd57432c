"""Mitsuba's global state: its variant and the LLVM library behind it. Set here and nowhere else."""
