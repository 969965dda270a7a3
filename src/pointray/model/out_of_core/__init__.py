"""Models in parts, built from clouds larger than memory, or split from a model in memory.

prepare : files -> a model in parts, resumable; split : a model in memory -> the same in parts
builder : all stages of a cloud on disk; work : finished stages, kept on disk; tasks, stages : a stage of a part
arrange : columns in kd order; local : a part with a margin of its neighbours; given : radii and stations of the files
separate_scattered : scattered points in columns of their own; scattered_parts : their parts
facing, signs, thin_sheets, disk_votes : signs of normals over all parts; second_layers : layers over all parts
trees : a tree for each part; finish : the files of the folder
levels, level_steps, grid, layer : levels of detail of all parts, and of one
exclusive_lock : one process at a time works in a folder; sorted_sets : sets as sorted arrays

The columns on disk are those of `base/disk_columns.py`; `io/spooling/` fills them. Begin with builder.
"""
