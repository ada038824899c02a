"""``morlnav-benchmark``: morlnav against its peers and against the machine's limit, one file per group of rows."""
