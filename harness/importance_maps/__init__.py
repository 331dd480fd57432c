"""Importance maps: images that say which direction each point of the unit square is sent to.

After Bai et al. (2023), BSDF Importance Baking. A slice of a BSDF becomes a density on the
projected disk (:mod:`.slices`), the density a map from the unit square (:mod:`.maps`): by
rows and columns (:mod:`.row_column`), by quadrants (:mod:`.hierarchical`) or by optimal
transport (:mod:`.transport`). :mod:`.quality` measures maps, :mod:`.database` keeps many.
"""
