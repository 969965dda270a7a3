"""Unit normals of points: directions from each point's neighbours, signs from all points together.

estimate : all steps on one page
jets : directions from fitted quadrics; fit_batch, axes, moments, jet : fits to the neighbours of 16 points at once
planes, quadrics : fits to one point's neighbours with any weights
orientation : signs that agree with those of the neighbours and face outward
agreement : how clearly two points face the same side
pieces : points joined in tiles; votes : between pieces; joins : pieces become groups
outward : which side is outside, and whether all normals face inward
layers : signs in noise and layers
sheets : signs where two sheets of a surface are close together
stations, visibility : signs from the positions of scanners
consistency : whether the signs of given normals agree; comparison : whether given normals are those of the surface
validation : which normals of a file are used

Begin with estimate.
"""
