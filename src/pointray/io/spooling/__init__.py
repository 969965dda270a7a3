"""Files larger than memory -> columns on disk, with the values that `gather` gives them in memory.

raw : the columns of a file as it holds them; convert : in the types of `Points`; spooled : the cloud on disk

Begin with spool.
"""
