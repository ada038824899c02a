"""morlnav beside its peers and the machine's limit, one file per group of rows: ``python -m benchmarks --help``.

No part of the package: a wheel holds none of it.
"""
