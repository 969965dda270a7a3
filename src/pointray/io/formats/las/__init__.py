"""LAS, LAZ and COPC, with laspy and lazrs.

las : the reader; _header : header and records; _rows : rows to columns; _laz : compressed chunks
_copc : nodes of the octree; _crs : coordinate systems
_write : the writer; _plan : point format and extra bytes to be written; _grid : integer coordinates to be written
copc : the writer of COPC; _octree : the octree to be written
"""
