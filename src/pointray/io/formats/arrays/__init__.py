"""Arrays of NumPy.

npy : one array; npz : an archive of arrays; _array : the header of an array; _members : those of an archive
"""
