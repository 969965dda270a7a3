"""Point clouds in memory: `Points`, their neighbours, normals, noise and outliers.

points, georeference : arrays of a cloud; coordinate system and scanner positions of its file
conversion, convertible : objects of other libraries as points, and points as such objects
shifting : addition of an offset to all positions
geographic : longitude and latitude in degrees to metres
neighbors : exact nearest neighbours; kd_ordering : the kd order of a cloud, computed once and shared
statistics, sampled_statistics : statistics of a whole cloud, shared by its parts
rounding : detection of coordinates rounded to steps that are coarse for the point spacing
normals : estimation and orientation of normals, validation of stored ones
denoising : smoothing of noisy points onto their surface
outliers : points that belong to no surface; layers of several scans
cleaning : exact duplicates and distant points
preparation : all stages between a file and a model, in order

Begin with points, then preparation.
"""
