"""The twelve named materials: procedural Mitsuba BSDFs, one file each.

Each file gives ``SUMMARY``, one line that begins with the regime the material stands for,
and ``bsdf()``, the Mitsuba dictionary (with texel arrays; numpy only, nothing is loaded).
All reflect only, have no delta lobe, and are one-sided.
"""
