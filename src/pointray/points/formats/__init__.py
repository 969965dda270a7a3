"""Files -> Points and back: one file a format.

ply : binary and text; ply_lists: rows that hold lists, of which each has its own length
"""
