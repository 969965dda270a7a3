"""A scene and a camera -> an image of linear radiance.

camera, lens : cameras; camera rays in kernels
settings : `Settings`; picture : `render`, and passes of samples; plan : arguments of a kernel from scene and settings
film : sample positions and pixel sums; noise : light and noise of an image, from these sums
integrate, baked : the kernels of a pass
lod, window : selection of levels of detail; the part of the image that models can cover
layers : AOVs, such as depth and normals; layer_dataset : their result, and its conversion to xarray
camera_path, sequence : cameras of a film; `animate`
pieces : an image in pieces, on the workers of a cluster; ray_forwarding/ : models that no single worker holds
warmup : compilation of kernels before they are needed

Begin with picture, then integrate. The folder is not called render, as it would hide `pr.render`.
"""
