"""What `python -m xrdslam` does before and after a run: composing, helping, explaining."""
