"""What every other part of the package may use: it imports nothing from the package.

arguments : checks of parameters
choices : the words that options, scene files and the viewer share
deprecation : warnings for renamed names
dependencies : hashes of the sources that a module imports, directly or not
extras : optional packages
progress, warning_log : progress callbacks; warnings that a thread may collect
memory, malloc_arenas : available memory, and returning freed memory to the system
atomic_write : files that appear complete or not at all
disk_columns : arrays on disk, read and written piece by piece
"""
