"""Tracing of 3D edges as in the paper: PECs, PEPCs, following, visibility, sampling."""
