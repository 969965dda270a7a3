"""LAS, LAZ and COPC, through laspy and lazrs.

las : which of them a file is; _header : what it announces; _rows : rows as columns; _laz : compressed chunks
_copc : the nodes of an octree; _crs : coordinate systems; _write : writing
"""
