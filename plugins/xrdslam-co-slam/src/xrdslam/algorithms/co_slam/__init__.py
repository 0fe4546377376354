"""Co-SLAM for xrdslam."""
