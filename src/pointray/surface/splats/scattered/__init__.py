"""Points that lie on no surface, as leaves and wires are, and how they are drawn.

rules : thresholds on the planes around a point; islands, fitted_normals : two further tests
spheres : sizes and directions; levels : levels of detail

Begin with classification.
"""
