"""Utilities for the rest of the package, from which they import nothing.

arguments : validation of parameters
arrays : names of array types for annotations
choices : names shared by options, scene files and the viewer
deprecation : warnings for renamed names
dependencies : hashes of the sources that a module imports, directly or indirectly
executor : protocols of executors, which run jobs in this process or on a cluster
extras : optional packages; registered : modules of higher rooms, imported when needed
progress, warning_log : progress callbacks; warnings collected per thread
memory, malloc_arenas : available memory, and returning freed memory to the system
atomic_write : files replaced atomically
disk_columns : arrays on disk, read and written in pieces
spelling : suggestions for misspelt names; manual : its address, and the page about an error
version : the package's version
"""
