"""File formats, read and written as `Points`.

Each format is one module with a `FORMAT` (`_source.Format`), which detects, opens and optionally writes files. Related
formats share a folder. Modules whose names begin with _ are helpers. To add a format, add a module here or in a folder;
nothing else needs to be registered.

_source : interface of the readers; _named_columns, _unnamed_columns : meaning of columns, by name or by values;
_world : coordinates to be written; _stations : points of each scanner to be written; _losses : what is not stored;
_counts : comparison of announced counts with the contents;
_packed_colors : colours packed in one number; _odd_numbers : NaN and infinity as Microsoft's C library writes them
ply : text and binary
las : LAS, LAZ and COPC
e57 : E57, through libE57
text : .xyz, .csv, .pts and similar; PTX; fast, exact parsing of numbers
pcd : ascii, binary, binary_compressed
arrays : NPY and NPZ
mesh : OBJ, STL, glTF, OFF: vertices, or points sampled on triangles
splats : 3D Gaussian splatting in four formats
depth : depth images
kitti : lidar sweeps without a header
colmap : sparse points of photogrammetry

Begin with _source, then ply/ply.
"""
