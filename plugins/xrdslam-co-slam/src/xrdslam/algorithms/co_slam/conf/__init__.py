"""Hydra configuration of Co-SLAM: what other datasets and presets change."""
