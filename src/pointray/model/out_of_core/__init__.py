"""Models in parts, built from clouds larger than memory or split from a model in memory.

prepare : files -> a model in parts, resumable; split : a model in memory -> a model in parts
builder : all stages of a cloud on disk; work : stages over all parts and their results on disk
tasks, stages : one stage for one part; local : a part with a margin of neighbours
arrange : columns in kd order; given : radii and scanner stations of the files
separate_scattered : columns of the points that lie on no surface; scattered_parts : their parts of the model
facing, signs : signs of normals across parts, found by votes that disk_votes stores
thin_sheets : signs of normals where two sheets are close; second_layers : second layers across parts
trees : one tree per part; finish : the files of the folder
layer : splats of a level of detail of all parts; levels, level_steps, grid : levels of detail from finer ones
exclusive_lock : lock on the folder; sorted_sets : sets of numbers as sorted arrays

The columns on disk are those of `base/disk_columns.py`; `io/spooling/` fills them. Begin with builder.
"""
