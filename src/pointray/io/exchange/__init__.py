"""Objects of other libraries -> `Points` and back, without importing these libraries before they are needed.

convert : detects the kind of an object, and converts it; entry point of `as_points`
columns : columns in memory, by name or by role, as a `Source` that `gather` reads like a file
arrays : NumPy arrays, plain and structured, and anything with `__dlpack__` or `__array__`
tables : pandas, polars and Arrow; open3d_clouds : Open3D; pyvista_data : PyVista; laspy_data : laspy
meshes : vertices of trimesh and meshio
facts : what each kind of object holds, for the documentation
losses : one warning about what a conversion cannot store; names of columns that are still free
"""
