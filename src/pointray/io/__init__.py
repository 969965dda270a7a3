"""Reading and writing of point cloud files. Geometry is not computed here.

files : `read` and `write`; reading : validation of the arguments of `read`
formats : one module or folder per format; known_formats : the registry of formats and the detection of a file's format
plugins : readers of other packages
inputs : the files to read, local or remote; unpacking : decompression of .gz and .zst
remote : files on servers, downloaded or read in pieces; previews : coarse versions of these
opening, selection : files to be opened, and the choice of their rows
gather, filling : assembly of the rows of several files into one cloud in memory
joining, locating, colors, missing_columns : common types and coordinates of several files, positions relative to an
origin, 8-bit colours, columns that only some files have
spooling : columns on disk for files larger than memory
exchange : objects of other libraries as points, and points as such objects
trajectory : the path of a moving scanner

Begin with files, then formats/_source.
"""
