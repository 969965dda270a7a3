"""Point clouds in memory: `Points`, their neighbours, normals, noise and outliers.

points, georeference : the arrays of a cloud; coordinate system, stations and scanner of its file
geographic : degrees of longitude and latitude to metres
neighbors : exact nearest neighbours; kd_ordering : the kd order of a cloud, computed once and shared
statistics : numbers of a whole cloud by which its parts are measured
rounding : coordinates that were rounded to steps coarse for the spacing
normals : estimation, orientation, validation of given ones
denoising : points moved onto the surface that they were measured from
outliers : points that belong to no surface; layers of several scans
cleaning : exact duplicates and distant points
preparation : all stages between a file and a model, in order

Begin with points, then preparation.
"""
