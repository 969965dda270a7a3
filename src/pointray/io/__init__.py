"""Files -> `Points` and back; nothing here computes with geometry.

files : `read` and `write`; reading : what `read` is asked for, checked
formats : one file or folder for each format; known_formats : which formats there are, and which one a file has
unpacking : .gz and .zst
opening, selection : the files, and which of their rows become points
gather, filling : the rows of several files become one cloud in memory
joining, locating, colors, missing_columns : what several files have in common; positions about an origin; 8-bit colours
spooling : the rows of files larger than memory become columns on disk
trajectory : the path of a moving scanner

Begin with files, then formats/_source.
"""
