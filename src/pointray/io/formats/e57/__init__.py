"""E57, read with libE57.

e57 : the reader; _header : the XML section, checked before libE57 opens the file; _scan : description of a scan
_write : the writer; _fields : columns to be written
"""
