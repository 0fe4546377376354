"""Tracker and Mapper as processes: the engine `engine=multiprocess`."""
