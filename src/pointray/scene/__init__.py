"""Scenes of models, planes and lights, and the tables that kernels read.

scene : `Scene`; rays : validation of rays, `Hits`; casting, paged_rays, blend : hits of rays and their attributes
instances, transforms, clips, paints : validation of the parts of a scene, and their records
world, visible_trees : `Snapshot`, an immutable scene with its tables
ownership : distribution of the instances over several processes

Begin with scene, then world.
"""
