"""Scenes of models, planes and lights, and the tables that kernels read.

scene : `Scene`; rays : validation of rays, `Hits`; casting : hits of checked rays
paged_rays : hits of rays that may need parts on disk; blend : attributes of the points at hits
crossings : all crossings of rays; separate_instances : groups of models that do not overlap, for these
nearest_surface : closest points on the surface; meshing : surface to triangles
hit_tables : hits to points and to tables of pandas
instances : `Plane`, the table of instances; transforms : matrices for `Scene.add`; clips : clip planes
paints : tables that turn attribute values into colours
world : `Snapshot`, an immutable scene with its tables; visible_trees : the table of trees, parts on disk opened for it
ownership : distribution of the instances over several processes

Begin with scene, then world.
"""
