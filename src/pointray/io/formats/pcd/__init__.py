"""PCD of PCL and Open3D.

pcd : ascii, binary and packed rows; _header : what a file announces; _lzf : how rows are packed
"""
