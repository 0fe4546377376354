"""SplaTAM: dense RGB-D SLAM on 3-D Gaussians."""
