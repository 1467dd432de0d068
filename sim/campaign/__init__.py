"""Many seeded runs from one file: missions, identifications, diagnoses, in processes or on a Dask cluster.

    file -> cases (pure) -> works -> outcomes, each kept as soon as it is there -> tables, report

A case is named by the hash of what it is made of, so that a second call knows what is done.
"""
