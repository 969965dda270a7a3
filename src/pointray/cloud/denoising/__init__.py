"""Denoising: noisy points are moved onto the surface that they were measured from; clean points are unchanged.

smooth : all steps on one page
noise : local estimates of the noise
fit : local surface of each point
candidates, solids, creases : planes where no quadric fits; edges : points that these planes move

Begin with smooth.
"""
