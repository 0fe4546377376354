"""Pictures of maps and of what they render, made without a window and without a GPU."""
