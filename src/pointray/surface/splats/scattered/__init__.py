"""Points that lie on no surface, such as leaves and wires: classification, radii and levels of detail.

classification : which points are scattered, from planes through their neighbours at four scales
rules : thresholds on local planes, and votes of neighbours; islands, fitted_normals : two further criteria
spheres : radii and directions; levels : levels of detail

Start with classification.
"""
