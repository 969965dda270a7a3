"""NumPy arrays.

npy : one array; npz : an archive of arrays; _array : header and rows of an array; _members : arrays of an archive
"""
