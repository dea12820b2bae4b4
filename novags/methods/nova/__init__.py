"""NOVA-GS, one file a section of the paper."""
