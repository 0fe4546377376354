"""Sequences of frames, one family of file layouts a module."""
