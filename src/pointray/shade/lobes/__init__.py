"""A shading point, a direction -> what a material does there: one file a kind, whose functions `shade/bsdf.py` calls.

phong : diffuse reflection, and Phong's highlight; microfacet : `Principled`; specular : mirrors and glass

A new kind is a file here, see ARCHITECTURE.md. Begin with phong.
"""
