"""NICE-SLAM for xrdslam."""
