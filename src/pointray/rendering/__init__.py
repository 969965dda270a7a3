"""A scene and a camera -> a picture of linear light.

camera, lens : where the picture is taken from; a point in a pixel becomes a ray
settings : how the picture is made; picture: pass after pass of samples
film : where samples lie in pixels, and the sums of their light; integrate: the kernels of a pass
lod, window : which level of detail is shown, and in which part of the picture models can be
layers : what each pixel shows, as numbers
camera_path : a camera in each frame of a movie
warmup : compiles kernels before they are needed

Begin with picture, then integrate. The folder is not called render: its name would take the place of `pr.render`.
"""
