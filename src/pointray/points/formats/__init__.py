"""Files -> `Points` and back: one file a format.

Each has a `FORMAT` (`_source.Format`), which says how a file is recognised, opened and perhaps written. Files whose
names begin with _ are parts of formats. A new format is a file here and nothing else.

_source : what a reader gives
ply : binary and text; _ply_header : what a file announces; _ply_lists : rows that hold lists of varying length
gaussians, compressed_gaussians, spz, splat : 3D Gaussian splatting; _splats : what they share
text : .xyz, .csv, .pts and the like; ptx : scans in grids
_lines, _first_look, _text_columns, _text_source : what the columns of a text are, and its rows
_numbers, _number_kernel : numbers in text, exactly and fast
e57 : scans with poses; _e57_header : its XML, which is checked before libE57 sees the file; _e57_scan : its scans
mesh : OBJ, STL, glTF, OFF; _mesh_load : what trimesh makes of them; _mesh_points : vertices, or points on triangles
depth : depth pictures
las : LAS, LAZ and COPC; _las_header : what a file announces; _las_rows : rows as columns; _las_laz : compressed chunks;
    _las_copc : nodes of an octree; _las_crs : coordinate systems; _las_write : writing
pcd : ascii, binary, packed; _pcd_header : what a file announces; _lzf : how it is packed
npy, npz : arrays; _arrays : one of them; _npz_members : those of an archive
kitti : sweeps without a header
_columns : what columns are by their names; _world : coordinates as they are written
_lines, _first_look, _columns, _text_source : what the columns of a text are, and its rows
_numbers, _number_kernel, _powers_of_ten : numbers in text, exactly and fast

Begin with _source, then ply.
"""
