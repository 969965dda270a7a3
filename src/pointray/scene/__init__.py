"""Models, planes and lights at their places -> what kernels read of a scene.

scene : `Scene`, what a caller builds and casts rays at; rays: these, and the hits
instances, transforms, clips, paints : the parts, as they are given and as records
world : from all parts to a `Snapshot`, which does not change any more

Begin with scene, then world.
"""
