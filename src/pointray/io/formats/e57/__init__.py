"""E57, through libE57.

e57 : scans with poses; _header : its XML, which is checked before libE57 sees the file; _scan : the rows of a scan
"""
