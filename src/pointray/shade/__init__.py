"""Hits, lights and materials -> radiance along the rays of a tile.

lights, environment, materials/, attributes : what callers give, as records; colormaps, pictures : what these read
tables : what is built once from a scene's lights
bsdf : what a surface does with light, by the kinds of materials/
emitters, sky : the light from a point on a light (`sample_light`), and from all around (`sample_sky`)
choice : which light a path chooses, and which it meets
shading_points : what is kept of the hits
direct, specular_rays : the integrator "phong"; ambient : "ao"; path : "path"; catcher : shadow catchers in all three

Begin with bsdf, then direct, then path.
"""
