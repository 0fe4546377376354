"""The interfaces: what a dataset, a map, a tracker, a mapper and an algorithm are."""
