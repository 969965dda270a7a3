"""A scene and a camera -> an image of linear radiance.

camera, lens : cameras; camera rays in kernels
settings : `Settings`; picture : `render`, and passes of samples
film : sample positions and pixel sums; integrate : the kernels of a pass
lod, window : selection of levels of detail; the part of the image that models can cover
layers : AOVs, such as depth and normals
camera_path, sequence : cameras of a film; `animate`
warmup : compilation of kernels before they are needed

Begin with picture, then integrate. The folder is not called render, as it would hide `pr.render`.
"""
