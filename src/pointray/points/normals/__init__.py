"""Points -> unit normals: directions from each point's neighbours, signs from all of them together.

estimate : the way on one page
jets, planes : the direction at a point, from a fitted surface or plane
orientation : one side for all of them
sheets : two surfaces close to each other, told apart
checks : whether the signs that were found can be trusted
given : whether the normals that a file has are those of its surface

Begin with estimate.
"""
