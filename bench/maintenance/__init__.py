"""Programs for work on pointray: counts, records of kernels, tables of documents, hashes of results."""
