"""Vox-Fusion for xrdslam."""
