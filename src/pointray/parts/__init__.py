"""Models in parts: how they are made.

trees : splats in kd order -> a file with a tree for each part
split : a model -> the same in parts
signs : normals of parts that agree over all parts

Begin with trees.
"""
