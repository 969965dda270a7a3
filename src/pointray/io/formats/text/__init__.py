"""Text formats and PTX.

text : .xyz, .csv, .pts and similar; ptx : gridded scans, _ptx_headers : their headers
_lines, _first_look, _columns : separators, header and columns of a text; _rows : its rows
_numbers, _number_kernel, _powers_of_ten : fast, exact parsing of numbers
_write, _ptx_write : the writers; _decimals : numbers as text
"""
