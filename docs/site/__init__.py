"""The documentation site: `python -m docs.site` runs the code of all pages, compares their pictures, calls Sphinx.

pages : the code, pictures and scans of a page
run_page : the code of one page, in a folder of its own; runs : pages run in processes, and results kept
screenshot : a picture of the page of `pointray view`
inputs : the scans that pages read, and stand-ins for those that are absent
pictures : comparison of produced with stored pictures
__main__ : all pages in parallel, then Sphinx

Begin with pages.
"""
