"""Points -> unit normals: directions from each point's neighbours, signs from all points together.

estimate : all steps on one page
jets : the direction at a point, from a fitted surface; sixteen, axes, moments, jet : fits to sixteen points at once
planes, quadrics : fits to one point's neighbours with any weights
orientation : signs that agree, and face outward
agreement : how clearly two points tell that they face the same side
pieces : points joined in tiles; votes : of pieces on each other; joins : pieces become groups
outward : which side is outside, and whether all normals face inwards
layers : signs in noise and layers
sheets : signs where two sheets of a surface lie close together
checks : whether the signs of given normals can be trusted
given : whether the normals in a file are those of its surface

Begin with estimate.
"""
