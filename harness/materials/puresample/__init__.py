"""Materials that are learned from the directions at which particles leave (PureSample).

After Li et al. (2025), section 5: f = density x albedo, per colour channel. The density is a flow
of the projected disk, the albedo a small network, both conditioned on the direction they come from.
"""
