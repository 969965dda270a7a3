"""3D Gaussian splatting.

gaussians : PLY files written by training; compressed_gaussians : PLY files of PlayCanvas; spz, _spz_write : SPZ of
Niantic; splat : .splat of antimatter15; _common : shared conversion to points; _flat : points to flat splats;
_own_shapes : shapes of splats that were read
"""
