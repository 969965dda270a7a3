"""Sheets of pictures to look at: first pictures, and scans beside other programs."""
