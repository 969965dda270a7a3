"""Models in parts: how they are made.

split : a model -> the same in parts
prepare : files -> a model in parts, whatever their size
spool : files -> columns as they are (raw), then in the types of a cloud (convert); spooled : what is known of it
columns : arrays on disk; arrange : columns in kd order; local : a part with a margin
given : what a cloud on disk comes with
large : the stages of a cloud on disk, kept by work; tasks, stages : each of them for one part
separate : scattered points, put into columns of their own; loose : their parts
alone : who works in a folder: one process, and perhaps workers who see it
facing : signs of normals over all parts, in the passes of signs
trees : splats in kd order -> a file with a tree for each part; finish : all files of the folder
levels : levels of detail of all parts; coarser, grid : for one part; layer : the columns of one of them

Begin with large.
"""
