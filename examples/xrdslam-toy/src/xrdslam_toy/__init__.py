"""An example of a third-party method: depth odometry and a map of points."""
