"""A scene and a camera -> a picture of linear light.

camera, lens : where it is taken from, and from a place in a pixel to a ray
settings : how it is made; picture: pass after pass of samples
film : the samples' places and the sums of what they bring; integrate: the kernels of a pass
lod, window : which level of detail is seen, and in which part of the picture models can be
layers : what each pixel shows, as numbers
camera_path : a camera in each frame of a film
warmup : kernels compiled before they are needed

Begin with picture, then integrate. The folder is not called render: its name would take the place of `pr.render`.
"""
