"""Points that lie on no surface, such as leaves and wires: classification, radii and levels of detail.

rules : thresholds on local planes; islands, fitted_normals : two further criteria
spheres : radii and directions; levels : levels of detail

Start with classification.
"""
