"""Models, planes and lights, placed in a scene -> what kernels read of it.

scene : `Scene`, which a caller builds and casts rays at; rays: the rays and their hits
instances, transforms, clips, paints : the parts, as the caller gives them and as records
world : all parts become a `Snapshot`, which never changes

Begin with scene, then world.
"""
