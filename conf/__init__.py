"""The config groups, which other projects compose through ``hydra.searchpath=[pkg://morlnav.conf]``."""
