"""Random walks of particles through microgeometry, whose directions of exit are all that is kept.

After PureSample (Li et al. 2025), section 4: a particle enters, meets the surface, samples its
micro-BSDF, survives by Russian roulette so that its weight stays one, and leaves or is absorbed.
"""
