"""Hits, lights and materials -> radiance along the rays of a tile.

lights, environment, materials/, attributes : public classes, and the records that kernels read
colormaps, pictures : colour maps and environment images
tables : light selection table and light trees of a scene
bsdf : evaluation and sampling of BSDFs; one file a material in materials/
emitters, sky : sampling of lights (`sample_light`) and of the environment light (`sample_sky`)
choice : selection of lights by paths, and intersection of rays with lights
shading_points : surface points of a tile
direct, specular_rays : the integrator "phong"; ambient : "ao"; path : "path"; catcher : shadow catchers in all three

Begin with bsdf, then direct, then path.
"""
