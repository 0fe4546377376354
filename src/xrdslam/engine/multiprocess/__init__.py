"""Tracker, Mapper and Visualizer as processes: the engine `engine=multiprocess`."""
