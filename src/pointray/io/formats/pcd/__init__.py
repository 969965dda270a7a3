"""PCD, the format of PCL and Open3D.

pcd : the reader; _header : header; _lzf : decompression; _write : the writer
"""
