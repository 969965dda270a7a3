"""Text, and PTX.

text : .xyz, .csv, .pts and the like; ptx : scans in grids
_lines, _first_look, _columns : what the columns of a text are; _rows : its rows
_numbers, _number_kernel, _powers_of_ten : numbers in text, exactly and fast
"""
