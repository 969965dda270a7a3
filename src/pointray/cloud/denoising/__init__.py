"""Noisy points -> points on the surface that they were measured from; clean points stay as they are.

smooth : all steps on one page
noise : how far points lie off their surface, place by place
fit : the surface beside each point
candidates, solids, creases : planes where no quadric fits; edges : which points they move

Begin with smooth.
"""
