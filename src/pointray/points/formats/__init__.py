"""Files -> Points and back: a module for each format.

ply : binary and text; ply_lists : rows that hold lists of varying length
"""
