"""Neural materials: NeuMIP (Kuznetsov et al. 2021) and NeuSample's simplified form of it.

A query (u, footprint, wi, wo) takes two stages. Stage 1, once per shading point, moves u by
a learned offset (:mod:`.offset`) and looks features up there (:mod:`.textures`); stage 2, once per
direction, decodes features and directions to reflectance (:mod:`.network`). The harness's
condition is what stage 1 leaves: ``[features, wi.xy]``. ``wi`` points to the camera (the papers'
omega_o), ``wo`` to the light.
"""
