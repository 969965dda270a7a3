"""Models in parts: how they are made.

columns : arrays on disk, for clouds that do not fit into memory
spool : files -> columns as they are (raw), then in the types of a cloud (convert); spooled : what is known of it
trees : splats in kd order -> a file with a tree for each part
split : a model -> the same in parts
signs : normals of parts that agree over all parts

Begin with trees.
"""
