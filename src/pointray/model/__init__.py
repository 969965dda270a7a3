"""`Model`: what rays hit of a cloud, in memory or in parts on disk.

model : `Model`, and its classes for saved models and models in parts; traceable: what a scene reads of a model
building, levels_of_detail : points to splats to a tree; coarser versions; model_data: the arrays and settings of both
array_file, model_file, model_folder : a model on disk, checked when it is read
model_cache : models that were built before, in the user's cache folder
splat_points : the splats of a model, for files of Gaussian splats
residency : which parts of a model on disk are open, within a memory budget
out_of_core : models of clouds larger than memory
preparation, preparation_options, scan_inputs : `prepare`: files to a prepared scan or a saved model

Begin with model.
"""
