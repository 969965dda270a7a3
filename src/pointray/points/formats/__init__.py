"""Files -> `Points` and back: one file a format.

Each has a `FORMAT` (`_source.Format`), which says how a file is recognised, opened and perhaps written. Files whose
names begin with _ are parts of formats. A new format is a file here and nothing else.

_source : what a reader gives
ply : binary and text; _ply_header : what a file announces; _ply_lists : rows that hold lists of varying length
pcd : ascii, binary, packed; _pcd_header : what a file announces; _lzf : how it is packed
npy, npz : arrays; _arrays : one of them; _npz_members : those of an archive
kitti : sweeps without a header
_columns : what columns are by their names; _world : coordinates as they are written

Begin with _source, then ply.
"""
