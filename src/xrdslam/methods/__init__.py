"""Stock trackers and mappers that any algorithm can be combined with."""
