"""A scene -> the light that arrives at its splats and planes, after all bounces: global illumination that is kept.

surfaces : sides of instances, cut into patches (patches: of models, planes: of planes)
transport, gather : links, what each patch receives light from; directions: of their rays; stretches: on a cluster
solve, bounces : lights -> light at the patches; sky: texels that links lead to; smooth: noise
store, pack : light at the patches -> the records that pictures read, see `shade/baked.py`; kept : all of a scene's
keys : what tells that a scene has changed; file : baked light as a file
levels, budget : coarser light, and which instances get it
exchange : the stages of a bake; baked : `bake`, `Baked`; settings : `BakeSettings`

Begin with baked.
"""
