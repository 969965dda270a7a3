"""Files -> `Points` and back: one file a format.

Each has a `FORMAT` (`_source.Format`), which says how a file is recognised, opened and perhaps written. Formats that
share much lie in one folder. Files whose names begin with _ are parts of formats. A new format is a file here, or in a
folder of its own, and nothing else.

_source : what a reader gives; _named_columns : what columns are by their names; _world : coordinates to be written;
_counts : counts that a header announces against what is there; _packed_colors : colours packed in a number
ply : binary and text
las : LAS, LAZ and COPC
e57 : E57, through libE57
text : .xyz, .csv, .pts and the like; PTX; and numbers in text, exactly and fast
pcd : ascii, binary, packed
arrays : NPY and NPZ
mesh : OBJ, STL, glTF, OFF: vertices, or points on triangles
splats : 3D Gaussian splatting in four formats
depth : depth pictures
kitti : sweeps without a header
colmap : sparse points of photogrammetry

Begin with _source, then ply/ply.
"""
