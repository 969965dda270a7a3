"""Models in parts, built from clouds larger than memory or split from a model in memory.

prepare : files -> a model in parts, resumable; split : a model in memory -> a model in parts
builder : all stages of a cloud on disk; work : results of stages on disk; tasks, stages : one stage for one part
arrange : columns in kd order; local : a part with a margin of neighbours; given : radii and stations of the files
separate_scattered : columns of scattered points; scattered_parts : their parts
facing, signs, thin_sheets, disk_votes : signs of normals across parts; second_layers : layers across parts
trees : one tree per part; finish : the files of the folder
levels, level_steps, grid, layer : levels of detail of all parts, and of one part
exclusive_lock : lock on the folder; sorted_sets : sets as sorted arrays

The columns on disk are those of `base/disk_columns.py`; `io/spooling/` fills them. Begin with builder.
"""
