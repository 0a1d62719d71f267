"""3D edges as the paper traces them: PECs, PEPCs, following, visibility, sampling."""
