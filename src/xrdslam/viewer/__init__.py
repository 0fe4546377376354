"""Watching a run in a browser, and a finished one again; videos without a window."""
