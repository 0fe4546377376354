"""Hydra configuration of NICE-SLAM: what other datasets and presets change."""
