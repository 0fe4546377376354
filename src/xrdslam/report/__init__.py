"""Reports: a run on one page, many runs in one table."""
