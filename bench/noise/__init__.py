"""Surfaces of noisy clouds beside those of Open3D and MeshLab."""
