"""3D Gaussian splatting.

gaussians : PLY files of training; compressed_gaussians : those of PlayCanvas; spz : of Niantic; splat : of antimatter15
_common : what they share
"""
