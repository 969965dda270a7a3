"""Unit normals of points: directions from each point's neighbours, signs from all points together.

estimate : all steps on one page
jets : directions from fitted quadrics; fit_batch, axes, moments, jet : fits for 16 points at once
planes, quadrics : fits to one point's neighbours with arbitrary weights
orientation : consistent signs that face outward
agreement : confidence that two normals face the same side
pieces : points joined within tiles; votes : evidence between pieces; joins : groups of pieces
outward : which side is outside, and whether all normals point inward
layers : signs in noisy and layered clouds
sheets : signs where two sheets of a surface are close together; winding : winding numbers, by which these are decided
stations, visibility : signs from scanner positions
consistency : do the signs of given normals agree; comparison : do given normals match the surface
validation : which normals of a file are used
units : normalisation of vectors

Begin with estimate.
"""
