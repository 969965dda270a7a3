"""Hits, lights and materials -> radiance along the rays of a tile.

lights, environment, materials/, attributes : public classes, and the records that kernels read
colormaps, pictures : colour maps and environment images
tables : light selection table and light trees of a scene
bsdf : evaluation and sampling of BSDFs; one file a material in materials/
emitters, sky : sampling of lights (`sample_light`) and of the environment light (`sample_sky`)
choice : selection of lights by paths, and intersection of rays with lights
shading_points : surface points of a tile
direct : direct light of the integrator "phong"; specular_rays : rays of mirrors and glass
ambient : "ao"; path : "path"; catcher : shadow catchers in these three integrators
backfaces : brightness of back faces, seen through holes of scans
baked_light : the integrator "baked"; baked, baked_sums, grid : lookup and blending of light records at the tile's hits
rgbe, baked_code : encoding of records' irradiance and of its directional distribution; harmonics : spherical harmonics
lobes, lobe_tables : reflection of baked light by wide glossy lobes

Begin with bsdf, then direct, then path.
"""
