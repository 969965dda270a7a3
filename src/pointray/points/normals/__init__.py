"""Points -> unit normals: directions from each point's neighbours, signs from all points together.

estimate : all steps on one page
jets, planes : the direction at a point, from a fitted surface or plane; quadrics : the surface
orientation : signs that agree
layers : signs in noise and layers
outward : which side is outside, and whether all normals face inwards
sheets : signs where two sheets of a surface lie close together
checks : whether the signs of given normals can be trusted
given : whether the normals in a file are those of its surface

Begin with estimate.
"""
