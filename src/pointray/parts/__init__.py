"""Models in parts: how they are made.

trees : splats in kd order -> a file with a tree for each part
split : a model -> the same in parts

Begin with trees.
"""
