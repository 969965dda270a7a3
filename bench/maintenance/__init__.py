"""Programs for work on pointray: counts, records of kernels, tables of documents, and hashes that two versions share."""
