"""Baked global illumination: the light that arrives at the splats and planes of a scene after all bounces.

surfaces : patches of all instances (patches: splats of models; planes: cells of planes); reflectance : their albedo
transport, gather : links from each patch to what it receives light from; directions : directions of the link rays;
    tile_ranges : link rays on the workers of a cluster
solve, bounces : irradiance of the patches; sky : texels of the sky and its bright spots; smooth : noise reduction
store, pack : irradiance of the patches -> records that rendering reads, see `shade/baked.py`; lookup_tables : all
    records of a scene
fingerprints : hashes that detect changes of a scene; file : baked light as a file
levels, budget : coarser light, and the choice of its level for each instance
exchange : the stages of a bake; baked : `bake`, `Baked`; settings : `BakeSettings`

Begin with baked.py.
"""
