"""Hydra configuration of Vox-Fusion: what other datasets and presets change."""
